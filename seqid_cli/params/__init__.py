"""The JSON documents: schema, reading, writing, migration. Nothing here needs numpy."""
