"""Neural materials (Kuznetsov et al. 2021, NeuMIP): pyramids of learned textures read by a small network."""
