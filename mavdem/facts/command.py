"""Codes of the command line: what it cannot read or write, and how a run ended."""

from mavdem.facts.fact import Code


class Unwritable(Code):
    """Why a file or folder cannot be written."""

    OUT_IS_A_FILE = "out_is_a_file"
    OUT_NOT_WRITABLE = "out_not_writable"
    OUT_REPLACES_INPUT = "out_replaces_input"
    OUT_FAILED = "out_failed"
    FILE_FAILED = "file_failed"


class NamedSource(Code):
    """Why what was named cannot be used."""

    STANDARD_INPUT_IS_NO_LOG = "standard_input_is_no_log"
    LINK_IS_NO_LOG = "link_is_no_log"
    AS_MANY_INPUTS_NEEDED = "as_many_inputs_needed"
    NONE_USABLE = "none_usable"


class RunEnd(Code):
    """Why a run ended early."""

    BAD_USAGE = "bad_usage"
    STANDARD_OUTPUT_FAILED = "standard_output_failed"
    INTERRUPTED = "interrupted"
    OUT_OF_MEMORY = "out_of_memory"
    DEFECT = "defect"
