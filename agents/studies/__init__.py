"""Studies behind the results pages, and the pages themselves."""
