"""Axes of a plot: where a value stands, and which values are named."""

import math

from .markup import short


class Axis:
    """From `values` to pixels between `begin` and `end`. Values that are texts stand side by side in their order."""

    def __init__(self, values, begin, end, log=False, from_zero=False):
        self.begin, self.end = begin, end
        self.names = None
        if any(isinstance(value, str) for value in values):
            self.names = list(dict.fromkeys(str(value) for value in values))
            self.log, self.low, self.high = False, -0.5, len(self.names) - 0.5
            return
        values = [value for value in values if value > 0 or not log]
        self.log = log and bool(values)
        low, high = (min(values), max(values)) if values else (0.0, 1.0)
        if self.log:
            low, high = math.log10(low), math.log10(high)
            margin = max((high - low) * 0.05, 0.05)
            self.low, self.high = low - margin, high + margin
        else:
            low = min(low, 0.0) if from_zero else low
            margin = (high - low) * 0.05 or abs(high) * 0.05 or 1.0
            self.low, self.high = (low if from_zero and low == 0 else low - margin), high + margin

    def shows(self, value):
        return not self.log or value > 0

    def at(self, value):
        if self.names:
            value = self.names.index(str(value))
        elif self.log:
            value = math.log10(value)
        return self.begin + (value - self.low) / (self.high - self.low) * (self.end - self.begin)

    def ticks(self):
        """[(pixel, text)]"""
        if self.names:
            return [(self.at(name), name) for name in self.names]
        values = self._decades() if self.log else self._steps()
        return [(self.at(value), short(value)) for value in values]

    def _decades(self):
        steps = (1,) if self.high - self.low > 3 else (1, 3) if self.high - self.low > 1.6 else (1, 2, 5)
        decades = range(math.floor(self.low), math.ceil(self.high) + 1)
        values = [step * 10.0**decade for decade in decades for step in steps]
        inside = [value for value in values if self.low <= math.log10(value) <= self.high]
        return inside if len(inside) > 1 else [10**self.low, 10**self.high]

    def _steps(self):
        span = self.high - self.low
        step = 10.0 ** math.floor(math.log10(span / 4))
        step = next(step * factor for factor in (1, 2, 5, 10) if span / (step * factor) <= 6)
        first = math.ceil(self.low / step)
        return [index * step for index in range(first, math.floor(self.high / step) + 1)]
