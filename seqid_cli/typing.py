"""Types of arrays, the same in all modules; docstrings give shapes and units."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
Complex = NDArray[np.complex128]
