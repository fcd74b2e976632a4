"""The demo: the node and a moving scene in one process, real topics in between.

``main`` is the console script ``obb_collision_demo``. What moves is in ``scene``, ``layout``,
``motion`` and ``shapes``; what talks in ``publisher`` and ``listener``; what draws in ``picture``,
``raster``, ``overlay`` and ``caption``; ``run`` puts it together.
"""

from obb_collision.node.demo.command import main

__all__ = ["main"]
