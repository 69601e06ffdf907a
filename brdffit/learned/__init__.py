"""Learned prefiltering: networks that predict the lobe that the fit would search for (Kemppinen et al. 2023)."""
