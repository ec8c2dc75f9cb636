"""The course's exercises: for each notebook, a file of checks that say what is wrong with an answer."""
