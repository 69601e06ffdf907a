"""Small networks in numpy and Numba: layers, gradients, Adam, training, files of weights; independent of materials."""
