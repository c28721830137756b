# Numba's decorators turn a function into a dispatcher whose types only Numba knows; what inference makes of its
# source (a call that "never returns", an intrinsic that misses its typing context) is wrong.
from typing import Any

def __getattr__(name: str) -> Any: ...
