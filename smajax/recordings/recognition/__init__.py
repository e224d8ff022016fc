"""Recognition of recordings whose layout and columns are not known: what each column is taken for, and why.

- ``findings``: sentences on what was recognised, and questions on what is doubtful.
- ``rows``: header, units and data among the first rows; ``text_layout`` and ``sheet_layout``: layout of a file.
- ``header_words``: the channel and the unit that a header names; ``unit_names``: units as people write them.
- ``value_ranges``: units, full scales and counts of a converter, judged by the values.
- ``clock``: time column, unit of the time, repeated stamps and restarts.
- ``column_choice``: what one column is taken for; ``channel_choice``: one column for each channel.
- ``answers``: texts such as ``force [N] factor=-0.0087 offset=7.5`` that decide what a column is.
- ``recognise``: all of it for a file.

The numbers are read by ``readers``; nothing is read in another way here.
"""
