"""Records of which a test needs only some fields."""


def partial_record(record_type, **values):
    """Makes a record of a dataclass or NamedTuple of which only some fields and properties have values.

    Its other defaults, properties and methods stay. Reading a dataclass's field without a value raises AttributeError;
    other fields of a NamedTuple are None.

    Args:
        record_type: The class of the record. The constructor of a dataclass, and so its checks, do not run.
        values: Values by the name of a field or of a property.

    Raises:
        TypeError: The record has no such field or property, for example since it was renamed.
    """
    fields = set()
    attributes = set()
    for base in record_type.__mro__:
        fields.update(vars(base).get("__annotations__", {}))
        attributes.update(vars(base))
    properties = {name: value for name, value in values.items() if name not in fields}
    unknown = [name for name in properties if name not in attributes]
    if unknown:
        raise TypeError(f"{record_type.__name__} has no fields {unknown}")
    field_values = {name: value for name, value in values.items() if name in fields}
    # A class of its own, since the values of properties belong to the class.
    partial_type = type(record_type.__name__, (record_type,), properties)
    if issubclass(record_type, tuple):
        return partial_type(**(dict.fromkeys(record_type._fields) | field_values))
    record = object.__new__(partial_type)
    for name, value in field_values.items():
        object.__setattr__(record, name, value)
    return record
