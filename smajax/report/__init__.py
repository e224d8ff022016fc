"""Presentation of results: documents (JSON), summaries for the terminal, figures, and report pages that open offline.

``documents`` has the model of each result document and reads the one of a folder; ``fit_document``, ``diagnosis`` and
the other ``*_document`` modules build them. ``summaries`` has the summary of each command's document for a terminal,
``result_figures`` its main figure, and ``rebuild`` its page, also of a finished run from its folder. ``prediction`` is
the table of measured and predicted rows. Figures are plotly's own (``figures``, ``sweep_plots`` and the ``*_figures``
modules); ``pages`` has the parts of an HTML page. Nothing here simulates or fits.
"""
