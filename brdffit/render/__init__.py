"""The renderer: references, pictures of appearances, lights, scenes, metrics, and the preview of a bake."""
