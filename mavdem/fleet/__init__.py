"""Fleet: many logs as one data set, a row for each flight, vehicle and axis."""
