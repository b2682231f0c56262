"""Where logs lie: on the disk, on object storage, and set aside while they are read."""
