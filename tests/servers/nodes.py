"""The servers of one cluster: what the scripts of clusters have in common."""


class Nodes:
    """Knows its servers by number, from 1. A command without a number is for all of them that run."""

    def __init__(self, nodes):
        self.nodes = nodes
        for number, node in enumerate(nodes, 1):
            node.name = "node %d" % number

    def chosen(self, number):
        if number is None:
            return self.nodes
        if not number.isdigit() or not 1 <= int(number) <= len(self.nodes):
            raise RuntimeError("there is no node %s; there are 1 to %d" % (number, len(self.nodes)))
        return [self.nodes[int(number) - 1]]

    def launch(self, number):
        """Starts nodes all at once, because each waits for the others. Returns them; they are not ready yet."""
        nodes = [node for node in self.chosen(number) if number is not None or not node.runs()]
        for node in nodes:
            node.launch()
        return nodes

    def each(self, number, action):
        answers = [action(node) for node in self.chosen(number) if number is not None or node.runs()]
        if not answers:
            raise RuntimeError("the cluster does not run")
        return answers[0]

    def kill(self, number=None):
        return self.each(number, lambda node: node.kill())

    def pause(self, number=None):
        return self.each(number, lambda node: node.pause())

    def resume(self, number=None):
        return self.each(number, lambda node: node.resume())

    def urls(self):
        return " ".join(node.url() for node in self.nodes)

    def commands(self):
        return {"kill": self.kill, "start": self.start, "pause": self.pause, "resume": self.resume}
