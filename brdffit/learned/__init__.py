"""Learned prefiltering: networks that say at once what the fit would search for (Kemppinen et al. 2023)."""
