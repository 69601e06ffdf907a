"""Learned prefiltering: networks that predict what the fit would search for (Kemppinen et al. 2023)."""
