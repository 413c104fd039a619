"""Array aliases of signatures; comments and docstrings state the shapes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ArrayLike = float | Array
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
JSON = dict[str, Any]
