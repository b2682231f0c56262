"""Torque that an identified model predicts of a log, and the documents and files that hold it."""
