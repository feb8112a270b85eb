"""What a sweep shows: statistics, tables, figures and a page of all of them."""
