"""One file per subcommand; each is a few cheap checks, one call and a rendering."""
