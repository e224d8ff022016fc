"""Presentation of results: documents (JSON), summaries for the terminal, figures, and report pages that open offline.

``fit_document``, ``comparison_document`` and ``diagnosis`` build result documents; ``summary`` and the ``text``
functions format them for a terminal. ``prediction`` is the table of measured and predicted rows. Figures are plain
dictionaries for plotly (``figures``, ``sweep_plots`` and the ``*_figures`` modules); ``pages`` and ``run_pages`` build
HTML pages, and ``rebuild`` builds the page of a finished run again from its folder. Nothing here simulates or fits.
"""
