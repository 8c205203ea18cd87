"""Each module measures one table, ours beside the peers, in one run: python -m benchmarks."""
