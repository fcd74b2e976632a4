"""The demo: the node and a moving scene in one process, real topics in between."""
