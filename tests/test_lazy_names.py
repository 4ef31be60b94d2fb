"""Names of packages that are imported when they are used."""

from pytest import raises

from mavdem.dem.settings import Settings
from mavdem.lazy_names import lazy_names


def test_a_name_is_that_of_its_module_and_another_one_is_an_attribute_error():
    imported_name = lazy_names("mavdem.dem", {"Settings": "settings"})
    assert imported_name("Settings") is Settings
    with raises(AttributeError, match=r"'mavdem\.dem' has no attribute 'Gaussian'"):
        imported_name("Gaussian")
