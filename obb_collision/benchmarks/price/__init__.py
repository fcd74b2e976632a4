"""The price of accuracy: what ``obb_collision.benchmarks.accuracy`` measures, tells and draws."""
