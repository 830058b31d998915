"""The cut of Ibaraki et al., recomputed: engagement, force and wall error before and after.

Importing this package turns on 64-bit floats, which exact paths need.
"""

import jax

jax.config.update("jax_enable_x64", True)
