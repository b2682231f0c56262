"""Reading of recorded logs: files in, `Recording` out."""
