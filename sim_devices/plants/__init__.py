"""Plants: compiled forward dynamics of arms, hands and gel at 16 substeps a millisecond."""
