"""Rods drawn in 3D with matplotlib: stills, and motions as a GIF or an HTML page.

Needs the extra `plots`; `import softrod_jax` does not import it.
"""

try:
    import matplotlib as _matplotlib  # noqa: F401
    import PIL as _PIL  # noqa: F401
except ImportError as e:
    raise ImportError(f"softrod_jax.pictures: {e}: pip install 'softrod_jax[plots]'") from None

from softrod_jax.pictures.animation import animate as animate
from softrod_jax.pictures.drawing import TENDON_COLOURS as TENDON_COLOURS
from softrod_jax.pictures.drawing import draw_rod as draw_rod
from softrod_jax.pictures.drawing import rod_axes as rod_axes
from softrod_jax.pictures.film import film as film
from softrod_jax.pictures.mode_shapes import modes_picture as modes_picture
from softrod_jax.pictures.stills import draw_stills as draw_stills
from softrod_jax.pictures.stills import picture as picture
from softrod_jax.pictures.stills import stills as stills
