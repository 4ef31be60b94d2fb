"""Serve: logs dropped in a browser, their pages, and the library of flights, over HTTP."""
