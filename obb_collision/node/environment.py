"""What the process environment must say before rclpy is used."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def set_defaults() -> None:
    """Set AMENT_PREFIX_PATH to this Python's prefix where ROS came by pip and nobody set it.

    rclpy's wheels keep the ament index there, and what asks it raises where the variable is unset.
    """
    if (Path(sys.prefix) / "share" / "ament_index").is_dir():
        os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
