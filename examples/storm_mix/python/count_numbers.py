"""Counts how often each number came by whom."""
import collections

import storm


class CountNumbers(storm.BasicBolt):
    def initialize(self, conf, context):
        self.counts = collections.Counter()
        self.task = context["taskid"]

    def process(self, tup):
        _, number, _, by = tup.values
        self.counts[number, by] += 1
        storm.emit([str(number), by, self.counts[number, by], self.task])


CountNumbers().run()
