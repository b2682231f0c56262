"""Tests: `unit` mirrors the package, `commands` runs the program from outside."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[1]  # of the project
