"""The shaped micro-electrodes of Guo, Pei, Yu and Li: what their sizes depend on.

Importing this package turns on 64-bit floats, which calibration needs.
"""

import jax

jax.config.update("jax_enable_x64", True)
