"""Charts: what is drawn, as data that pages, matplotlib figures and the Rerun dashboard share."""
