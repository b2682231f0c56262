"""Written forms of an arm, brought back to life by what others run them with."""
