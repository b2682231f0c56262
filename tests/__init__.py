"""Tests: `unit` mirrors the package, `commands` runs the program from outside."""

from pathlib import Path

ROOT = Path(__file__).parents[1]  # of the project
