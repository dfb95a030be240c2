"""What the channels accepted, and what came of it: the books of ledger_driver.cc, ledger_bolt.cc and ledger_reader.cc,
and the judgement over them.

The topology sends a command back for each message that its bolt had. Commands are durable, and none may be missing: they
wait for an instance that is restarted or moves to another host. A command that the broker has not confirmed may be given
up, because its message comes again; that promise ends with the message (never_stored()).

What may be missing follows from what each channel promises:
- `spooled`: nothing, whatever dies.
- `blocked`: nothing, unless the run of the instance ended before its last messages were confirmed (its host was killed,
  or the instance was closed while the broker was away). Then the end of that run may be missing: all messages from some
  number on, and no others.
- both, and commands: what a broker had confirmed and nobody had read when the broker lost its data (`emptied`): of each
  instance only messages that were accepted before that moment and come after all those that had been read by then. The
  readers' queues are gone, too. A reader may lack what was accepted until it has declared its queue again, because a broker that has the
  other reader's queue confirms.
"""

import collections
import dataclasses
from pathlib import Path

SPOOLED, BLOCKED = "spooled", "blocked"
UNSTORED_S = 5  # a broker that is not killed has stored by then what it has handed on, on a busy machine, too


@dataclasses.dataclass
class Run:
    """One life of an instance: opened, killed or closed. Times are those of time.monotonic()."""
    name: str
    begin: float
    end: float = None  # when it was closed; None: it was killed, or it lives
    sent: list = dataclasses.field(default_factory=list)  # times at which 1, 2, ... were accepted
    last: float = 0.0  # time of its last line
    killed: bool = False  # its process lives no more, and had not closed it


@dataclasses.dataclass
class Copy:
    run: str
    number: int
    time: float
    marked: bool = False  # the reader was told that somebody may have had it before
    worker: str = ""  # of a copy that the topology's bolt had: the process


@dataclasses.dataclass
class Account:
    """One instance."""
    instance: str
    kind: str
    runs: list  # in order of their begin
    came: list  # copies that the topology's bolt had, in the order of their coming
    read: list = None  # those that the second reader had; None: it does not read this instance
    heard: list = None  # commands that the driver got; None: somebody may stop the instance, and they are not judged


def lines(file):
    """Words of each whole line; none when there is no file."""
    file = Path(file)
    content = file.read_text() if file.exists() else ""
    return [line.split() for line in content.split("\n")[:-1]]


def read_sent(file):
    """The runs in a book of the driver. Raises ValueError for a line that no driver writes."""
    runs = {}
    for words in lines(file):
        what, name, moment = words[0], words[1], float(words[-1])
        if what == "run":
            runs[name] = Run(name, moment)
        elif what == "sent" and int(words[2]) == len(runs[name].sent) + 1:
            runs[name].sent.append(moment)
        elif what == "end":
            runs[name].end = moment
        else:
            raise ValueError(f"{file}: {' '.join(words)}")
        runs[name].last = moment
    return sorted(runs.values(), key=lambda run: run.begin)


def read_came(file):
    return [Copy(run, int(number), float(moment), marked == "1", process) for run, number, process, marked, moment in
            lines(file)]


def read_heard(file):
    return [Copy(run, int(number), float(moment)) for run, number, _, moment in lines(file)]


def read_read(file):
    return [Copy(run, int(number), float(moment), marked == "1") for run, number, marked, moment in lines(file)]


def account(folder, instance, kind, stays, second_reader=True):
    """`stays`: nobody stops or undeploys the instance. `second_reader`: there is one, which reads the instances that
    stay."""
    folder = Path(folder)
    return Account(instance, kind, read_sent(folder / f"{instance}.sent"), read_came(folder / f"{instance}.came"),
                   read_read(folder / f"{instance}.read") if stays and second_reader else None,
                   read_heard(folder / f"{instance}.heard") if stays else None)


def check(accounts, emptied=(), outages=()):
    """Sentences about what is wrong; none when all is as promised. `emptied`: when the broker lost its data; `outages`: when
    it was killed, and when it was started again."""
    wrong = []
    for one in accounts:
        who = f"{one.kind} {one.instance[:8]}"
        wrong += [f"{who}: {text}" for text in overlapping(one.runs)]
        for where, copies in (("the topology", one.came), ("the second reader", one.read)):
            if copies is None:
                continue
            found = missing(one, copies, lost_spans(one, copies, emptied)) + foreign(one, copies) + \
                out_of_order(one, copies) + unmarked(copies)
            wrong += [f"{who}, {where}: {text}" for text in found]
        wrong += [f"{who}, commands: {text}" for text in of_commands(one, emptied, outages)]
    return wrong


def commands(one, outages=()):
    """The commands that the topology sent to the instance, as one run that accepted them when its bolt had the message for
    the first time, and the copies that came back to the driver. Those that may be lost with their messages are left out."""
    numbers, sent, lost = {}, [], never_stored(one, outages)
    for copy in one.came:
        if (copy.run, copy.number) not in numbers and (copy.run, copy.number) not in lost:
            sent.append(copy.time)
            numbers[copy.run, copy.number] = len(sent)
    heard = [Copy("1", numbers.get((copy.run, copy.number), 0), copy.time) for copy in one.heard]
    return Account(one.instance, SPOOLED, [Run("1", 0.0, sent=sent)], heard)


def never_stored(one, outages):
    """Messages, as (run, number), that a broker may have lost which was killed, although the topology had had them and no
    command of them came back. A broker hands a message on before it has stored it, and confirms it afterwards; who sends it
    sends it again until then. So it is lost only if its run, of a blocked channel, ended before it reached the broker that
    was started again: then no message of the run came any more but older ones, which the broker had stored."""
    lost = set()
    for run in one.runs:
        if one.kind != BLOCKED or not ended(one, run):
            continue
        first, last = {}, {}
        for copy in one.came:
            if copy.run == run.name:
                first.setdefault(copy.number, copy.time)
                last[copy.number] = copy.time
        answered = max((copy.number for copy in one.heard if copy.run == run.name), default=0)
        for killed, started in outages:
            stored = max((number for number, moment in last.items() if moment >= started), default=0)
            lost |= {(run.name, number) for number, moment in first.items()
                     if number > max(stored, answered) and moment > killed - UNSTORED_S}
    return lost


def of_commands(one, emptied, outages):
    if one.heard is None:
        return []
    sent = commands(one, outages)
    found = missing(sent, sent.came, lost_spans(sent, sent.came, emptied))
    found = [text.replace("accepted messages of run 1", "commands") for text in found] + foreign(sent, sent.came)
    # Each worker sends in order. When an instance moves to another worker while no broker takes commands, both have some.
    worker = {}
    for copy in one.came:
        worker.setdefault((copy.run, copy.number), copy.worker)
    for name in dict.fromkeys(worker.values()):
        found += out_of_order(sent, [command for command, heard in zip(sent.came, one.heard)
                                     if worker.get((heard.run, heard.number)) == name])
    return found


def silent(accounts, since):
    """Sentences about readers to which no message came that was accepted after this moment."""
    wrong = []
    for one in accounts:
        sent = {run.name: run.sent for run in one.runs}
        for where, copies in (("the topology", one.came), ("the second reader", one.read), ("the driver", one.heard)):
            if copies is not None and not any(copy.run in sent and copy.number <= len(sent[copy.run]) and
                                              sent[copy.run][copy.number - 1] > since for copy in reversed(copies)):
                wrong.append(f"{one.kind} {one.instance[:8]}, {where}: no new message came")
    return wrong


def accepted(folder):
    """By instance, how many messages its channel accepted so far."""
    return {book.stem: sum(words[0] == "sent" for words in lines(book)) for book in Path(folder).glob("*.sent")}


def otherwise_than_listed(active, since, before, now):
    """Sentences about instances that are listed as active and send nothing, or are not and send. `active`: ids; `since`,
    `before` and `now`: as accepted() tells, when the wait began, when these were listed, and some time later."""
    return [f"{instance[:8]} is listed as active, and sends nothing" for instance in sorted(active)
            if now.get(instance, 0) <= since.get(instance, 0)] + \
        [f"{instance[:8]} is not listed as active, and sends: {now[instance] - before.get(instance, 0)} messages"
         for instance in sorted(set(now) - set(active)) if now[instance] > before.get(instance, 0)]


def overlapping(runs):
    """An instance of which two ran at the same time: an earlier run wrote a line after a later one had begun."""
    return [f"run {earlier.name} went on for {earlier.last - later.begin:.2f} s after run {later.name} had begun"
            for earlier, later in zip(runs, runs[1:]) if earlier.last > later.begin]


def lost_spans(one, copies, emptied):
    """For each time that the broker lost its data: (the newest message that had come by then, until when messages were
    accepted that may be lost). A reader that does not come back is not excused."""
    accepted = {(place, number): moment for place, run in enumerate(one.runs) for number, moment in enumerate(run.sent, 1)}
    place = {run.name: number for number, run in enumerate(one.runs)}
    keys = [((place.get(copy.run, -1), copy.number), copy.time) for copy in copies]
    spans = []
    for moment in emptied:
        newest = max((key for key, time in keys if time < moment), default=(-1, 0))
        spans.append((newest, min((accepted[key] for key, _ in keys if accepted.get(key, 0) > moment), default=moment)))
    return spans


def absent(one, copies, spans=()):
    """By run, the numbers of accepted messages of which no copy came. `spans`: as lost_spans() tells, which are excused."""
    there = collections.defaultdict(set)
    for copy in copies:
        there[copy.run].add(copy.number)
    return {run.name: [number for number in range(1, len(run.sent) + 1) if number not in there[run.name] and not any(
        run.sent[number - 1] < until and (place, number) > newest for newest, until in spans)]
        for place, run in enumerate(one.runs)}


def mark_killed(accounts, living):
    """Of the last runs, which look as if they lived: nothing follows on a run of an instance that was undeployed while its
    host stood still. `living`: process ids, as text."""
    for run in (run for account in accounts for run in account.runs):
        run.killed = run.end is None and run.name.split(".")[0] not in living


def ended(one, run):
    """Whether the run was closed or killed."""
    return run.end is not None or run.killed or run is not one.runs[-1]


def missing(one, copies, spans):
    wrong = []
    for run, gone in zip(one.runs, absent(one, copies, spans).values()):
        if one.kind == BLOCKED and ended(one, run):
            newest = max((copy.number for copy in copies if copy.run == run.name), default=0)
            gone = [number for number in gone if number < newest]
        if gone:
            wrong.append(f"{len(gone)} of {len(run.sent)} accepted messages of run {run.name} never came: "
                         f"{ranges(gone)}; the first was accepted at {run.sent[gone[0] - 1]:.2f}")
    return wrong


def heard_of_guest(folder, instance):
    """How many commands came back to an instance that somebody may stop, each once."""
    return len({(copy.run, copy.number) for copy in read_heard(Path(folder) / f"{instance}.heard")})


def foreign(one, copies):
    """Messages that nobody sent. A run that was killed may have sent one more than its book says."""
    sent = {run.name: len(run.sent) for run in one.runs}
    strange = [copy for copy in copies if copy.run not in sent or not 1 <= copy.number <= sent[copy.run] + 1]
    return [f"{len(strange)} messages came that were never sent, such as number {strange[0].number} of run "
            f"{strange[0].run}"] if strange else []


def out_of_order(one, copies):
    """First copies that came after a newer message of their instance. What a run of a blocked channel had sent without an
    answer when it ended may come among messages of the next run: a broker that stood still meanwhile reads both processes'
    connections. So only each run by itself is judged there."""
    place = {run.name: number for number, run in enumerate(one.runs)}
    seen, newest, last, wrong = set(), (-1, 0), {}, []
    for copy in copies:
        key = (place.get(copy.run, -1), copy.number)
        before = (key[0], last.get(copy.run, 0)) if one.kind == BLOCKED else newest
        if key not in seen and key < before:
            wrong.append(f"number {copy.number} of run {copy.run} came at {copy.time:.2f} after number {before[1]}")
        seen.add(key)
        newest = max(newest, key)
        last[copy.run] = max(last.get(copy.run, 0), copy.number)
    return [f"{len(wrong)} messages were overtaken: {wrong[0]}"] if wrong else []


def unmarked(copies):
    """Of the copies of a message one may be without the mark."""
    count = collections.Counter((copy.run, copy.number) for copy in copies if not copy.marked)
    twice = [key for key, times in count.items() if times > 1]
    return [f"{len(twice)} messages came twice without the mark `redelivered`: number {twice[0][1]} of run {twice[0][0]}"
            ] if twice else []


def duplicates(copies):
    return len(copies) - len({(copy.run, copy.number) for copy in copies})


def ranges(numbers):
    """1, 2, 3, 7 -> "1-3, 7"."""
    parts = []
    for number in numbers:
        if parts and parts[-1][1] == number - 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    told = [str(first) if first == last else f"{first}-{last}" for first, last in parts]
    return ", ".join(told[:5]) + (f" and {len(told) - 5} more" if len(told) > 5 else "")
