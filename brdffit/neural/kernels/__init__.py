"""Compiled loops of the neural material: layers, textures, one step of training, evaluation."""
