"""One HTML page that shows a set averaged, baked and true, in any browser, without a connection."""
