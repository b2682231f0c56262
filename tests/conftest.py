"""Tests read what commands write to a pipe: workers of pytest say they were a screen's
width.
"""

from __future__ import annotations

import os

os.environ.pop("COLUMNS", None)
