"""`skygcs-cli report`: a day's log folder as one HTML page, and its figures as CSV.

Pure: day_figures (what is reported), flight_book (flights of one vehicle), link_figures (losses, radios, delays of
commands), approaches (how near vehicles came), day_reader (all of these from the entries of tlogs), planned (paths of a
plan), report_tables (the rows of page and CSV), svg_drawing, report_page.
Files: gathering (reads a folder), report_command.
"""
