"""The store of objects, the broad phase, and the check that composes them."""
