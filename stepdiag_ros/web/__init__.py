"""The page of `stepdiag web`: what runs, live, for a browser.  It only reads."""
