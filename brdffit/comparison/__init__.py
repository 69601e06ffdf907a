"""The comparison: bake by every method, render and measure; it makes records and pictures, ``report`` the page."""
