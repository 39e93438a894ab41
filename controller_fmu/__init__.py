"""Controllers of depth, as pure functions and blocks: `l1` has the law of the paper, `baselines` others."""
