"""The HTTP server of ``mavdem serve``: uploads, the library of flights, who may see them, and the pages of results."""
