"""Work on many logs at once: processes on one machine, or Dask on many."""
