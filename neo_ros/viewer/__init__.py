"""The remote assistant's page: a web server that shows the live wide stream, view only."""
