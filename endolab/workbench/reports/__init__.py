"""What is left of a run for people: folders of files, pages, sheets to print."""
