"""The report of a tuning in sentences and tables, made of facts (coded findings): result, margins, gains, remedies."""
