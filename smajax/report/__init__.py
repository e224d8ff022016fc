"""What a run says: the result file, its table of predictions, a summary in words, pictures, and the HTML report."""
