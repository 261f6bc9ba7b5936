"""How HTML pages, strips of pictures, plots and plans look."""
