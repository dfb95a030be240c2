"""The figures of the paper's section 5: `report` runs them, `sizes` and `drivers` take them, `application/` is measured."""
