"""The detector and the avoidance system of Nishikawa et al., on a simulated mill.

Importing this package turns on 64-bit floats, which the simulation needs.
"""

import jax

jax.config.update("jax_enable_x64", True)
