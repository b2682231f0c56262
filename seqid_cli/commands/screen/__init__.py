"""What commands print: tables, charts, progress, text that steers no terminal."""
