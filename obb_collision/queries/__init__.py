"""Questions about boxes, one file each."""
