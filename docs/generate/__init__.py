"""Generated parts of the documentation site: what code, schemas and data files state is not typed a second time.

``hook`` is what MkDocs calls. A page of ``docs`` that has the line ``<!-- generated: NAME -->`` gets the text of that
name there (``pages.PARTS``); whole pages are in ``pages.whole_pages``. The other modules each make one kind of text as
Markdown.
"""
