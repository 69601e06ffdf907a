"""Scenes: who looks at a surface, from where and under which light, and what a bake of it has to compute."""
