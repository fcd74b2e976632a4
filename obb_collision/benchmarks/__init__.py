"""What accuracy costs and how fast it is, beside the peers installed."""
