"""Mathematics that means the same on a float and on a CasADi symbol.

Blocks call these functions instead of `math` and `if`, so that one source runs as Python and is
traced to C. Names are as in `math` and NumPy. Floats need the standard library alone; CasADi is
loaded when the first symbol arrives. Annotations have `float` and `bool` for both.
"""

from fmus.numerics import arrays, choice, elementary, stepping
from fmus.numerics.arrays import *  # noqa: F403
from fmus.numerics.choice import *  # noqa: F403
from fmus.numerics.elementary import *  # noqa: F403
from fmus.numerics.stepping import *  # noqa: F403

__all__: list[str] = []
__all__ += elementary.__all__
__all__ += choice.__all__
__all__ += arrays.__all__
__all__ += stepping.__all__
