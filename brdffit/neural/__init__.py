"""Neural materials (Kuznetsov et al. 2021, NeuMIP): pyramids of learned features, decoded by a small network."""
