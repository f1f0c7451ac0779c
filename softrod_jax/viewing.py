"""A rod to touch: a page in the browser, where sliders drive it and it moves in real time."""

from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING

from softrod_jax.bvp.collocation import Collocation
from softrod_jax.foundation.precision import require_float64
from softrod_jax.scene.scene import Scene

if TYPE_CHECKING:
    from softrod_jax.live.page import Page


def view(
    scene: Scene,
    *,
    dt: float = 1 / 60,
    method: Collocation = Collocation(6),
    most: Mapping[str, float] | None = None,
    log: str | PathLike = "view.csv",
    host: str = "127.0.0.1",
    port: int = 8080,
    block: bool = True,
) -> "Page":
    """Open a page on which the rod moves in real time, with sliders for tensions, pulls, pressures
    and gravity.

    - `dt` [s]: the time step; `method`: the grid along the rod.
    - `most`: how far the sliders go, in SI units, by kind ("tensions", "pressures", "pulls"); by
      default about a quarter of a circle.
    - `log`: where the button "Save log" writes what was done.
    - `host`, `port`: where the page is; of a machine elsewhere, forward the port.
    - `block`: show until interrupted; else a thread does, until `.stop()` of what is returned.

    Needs the extra `view`; raises `ImportError` without it, and `ValueError` for a bad scene or
    step, and without float64.
    """
    require_float64("view")
    # They need what is no part of the core.
    from softrod_jax.live.page import Page
    from softrod_jax.live.session import Session

    page = Page(Session(scene, dt, method=method, most=most), host, port, log)
    if not block:
        import threading

        threading.Thread(target=page.run, daemon=True).start()
        return page
    print(f"http://{host}:{page.port} shows the rod; Ctrl-C ends it")
    try:
        page.run()
    except KeyboardInterrupt:
        page.stop()
    return page
