"""Results for people: documents (JSON), summaries for the terminal, figures, and report pages that open offline.

``fit_document``, ``comparison_document``, ``diagnosis`` and ``tuning`` build the result documents; ``summary`` and
the ``text`` functions put them into words. ``prediction`` is the table of measured and predicted rows. Figures are
plain dictionaries for plotly (``figures`` and the ``*_figures`` modules); ``pages`` and ``run_pages`` make HTML of
them, and ``rebuild`` makes the page of a finished run again from its folder. Nothing here simulates or fits.
"""
