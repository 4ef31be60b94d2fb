"""Reports: results in sentences, tables, charts and pages.

``templates`` renders facts by the TOML files of ``sentences`` and ``sections``. The other modules here make sentences
and tables (``blocks``) of one subject each. ``charts`` has what is drawn, ``pages`` the HTML pages, and ``figures``
draws charts with matplotlib.
"""
