"""Searches by date with what they find, which the library and the page of a fleet must both do."""

FLIGHT_DATES = (
    "2021-12-31T23:59:00",
    "2022-03-09T00:00:00",
    "2022-03-09T13:18:05",
    "2022-04-01T08:00:00",
    "",
)
"""When flights began, in the order of time, and last one without a date."""

FOUND_BY_DATE = {
    "date<=2022-03-09": [0, 1, 2],
    "date<2022-03-09": [0],
    "date>2022-03-09": [3],
    "date>=2022-03-09": [1, 2, 3],
    "date:2022-03-09": [1, 2],
    "date=2022-03": [1, 2],
    "date>2022-03": [3],
    "date:2022": [1, 2, 3],
    "date>2021": [1, 2, 3],
    "date<=2021": [0],
    "date:2022-03-09T13": [2],
    "date>2022-03-09t00:00": [2, 3],
}
"""Places in ``FLIGHT_DATES`` that a search finds."""
