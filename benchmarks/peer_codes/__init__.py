"""The same plates in other tools: one file a peer, each with `make(problem, threads) -> run`."""
