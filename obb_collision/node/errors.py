"""The one exception of the node: an item of a message that can't be used, and why."""

from __future__ import annotations


class RefusedError(ValueError):
    """An item of a message is refused.

    ``reason`` is a short fixed phrase, the key under which ``/diagnostics`` counts it;
    ``detail`` says more about this one item.
    """

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason
        self.detail = detail
