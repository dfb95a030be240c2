"""Emits each reading again, and by whom."""
import storm


class Relay(storm.BasicBolt):
    def process(self, tup):
        storm.emit([*tup.values, "Python"])


Relay().run()
