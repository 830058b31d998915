"""The cavities of Yu and Masuzawa (1997), recomputed by the layer law.

Importing this package turns on 64-bit floats, which calibration needs.
"""

import jax

jax.config.update("jax_enable_x64", True)
