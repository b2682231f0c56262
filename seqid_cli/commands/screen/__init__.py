"""What the commands print: tables, charts, progress, and text that no terminal can mistake."""
