"""Small networks in numpy and Numba: layers forward and backward, Adam, weights on disk; knows nothing of materials."""
