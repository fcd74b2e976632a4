"""Patterns for names of objects: ``gripper/*``, ``*`` or a whole name; case counts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from fnmatch import translate

import numpy as np
from numpy.typing import NDArray


def as_patterns(value: Iterable[str] | str, name: str) -> tuple[str, ...]:
    """Return patterns from one or several; ValueError naming the argument for anything else."""
    patterns = (value,) if isinstance(value, str) else tuple(value)
    for pattern in patterns:
        if not isinstance(pattern, str) or not pattern:
            raise ValueError(f"{name} must be names or patterns like 'gripper/*', got {pattern!r}")
    return patterns


def matching(patterns: Iterable[str], names: Sequence[str | None]) -> NDArray[np.bool_]:
    """Return (n,) whether each name, None for nothing, matches any of the patterns."""
    matches = [re.compile(translate(pattern)).match for pattern in patterns]
    found = (name is not None and any(match(name) for match in matches) for name in names)
    return np.fromiter(found, np.bool_, len(names))
