#!/usr/bin/python3
"""How figure 12 takes a frame's time apart and judges; no program runs."""
import contextlib
import io
import os
import struct
import subprocess
import tempfile
import unittest
from pathlib import Path

from brokers_report import Report
from paper.points import Pair
from turtlebot import FIGURE, ON_STORM, PLACED, figure, on_storm, parts, placed, tap

MS = 1_000_000
PERIOD = 50 * MS
HEAD = "seq,time_ms,render_us,encode_us,payload_bytes,answered,latency_us,monotonic_us\n"


def row(sequence, captured_ms, latency_us="2000", answered="1"):
    return f"{sequence},{1000 + sequence},500.0,400.0,60000,{answered},{latency_us},{captured_ms * 1000:.1f}\n"


def packet(at_ms, to_broker, peer, size, head=b""):
    return tap.Packet(round(at_ms * MS), to_broker, peer, size, head)


class PartsTest(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = Path(temporary.name)

    def frames(self, text):
        (self.folder / "trace.csv").write_text(HEAD + text)
        return parts.read_trace(self.folder / "trace.csv")

    def stamps(self, component, born, begin, end):
        (self.folder / f"{component}-3.csv").write_text(
            f"time_ms,born_ns,begin_ns,end_ns\n1000,{round(born * MS)},{round(begin * MS)},{round(end * MS)}\n")
        return parts.read_stamps(self.folder, component)

    # A frame captured at 100 ms, encoded at 100.4, with its command at 102.
    PACKETS = [packet(100.45, True, 7, 60200), packet(100.5, False, 7, 21), packet(100.9, False, 9, 21),
               packet(101.0, False, 9, 60250), packet(101.55, True, 9, 300, b'..{"linear":..'),
               packet(101.8, False, 8, 320, b'..{"linear":..')]

    def one(self, packets):
        frame, = self.frames(row(0, 100))
        decode, follow = self.stamps("decode", 101.1, 101.2, 101.4), self.stamps("follow", 101.1, 101.41, 101.5)
        return parts.parts_of(frame, decode, follow, packets and parts.Wire(packets)), frame

    def test_the_parts_add_up_to_the_whole(self):
        (shares, closer), frame = self.one(self.PACKETS)
        expected = {parts.LATE: 0, parts.ENCODE: 0.4, parts.TO_BROKER: 0.05, parts.TO_SPOUT: 0.65, parts.TO_BOLT: 0.1,
                    parts.COMPUTE: 0.3, parts.BACK: 0.5}
        self.assertEqual(list(shares), list(parts.PARTS))
        for name, value in expected.items():
            self.assertAlmostEqual(shares[name], value, msg=name)
        self.assertAlmostEqual(sum(shares.values()), frame.whole_ms)
        self.assertAlmostEqual(closer[parts.IN_BROKER], 0.55)
        self.assertAlmostEqual(closer[parts.TO_WORKER], 0.1)
        self.assertAlmostEqual(closer[parts.BACK_WORKER], 0.05)
        self.assertAlmostEqual(closer[parts.BACK_BROKER], 0.25)
        self.assertAlmostEqual(closer[parts.BACK_HOST], 0.2)

    def test_a_frame_may_pass_in_several_packets(self):
        two = [packet(100.42, True, 7, 59000), packet(100.45, True, 7, 1200), *self.PACKETS[1:]]
        self.assertAlmostEqual(self.one(two)[0][0][parts.TO_BROKER], 0.05)

    def test_without_the_wire_the_broker_is_in_one_part(self):
        (shares, closer), frame = self.one(None)
        self.assertAlmostEqual(shares[parts.UNSEEN], 0.7)
        self.assertAlmostEqual(sum(shares.values()), frame.whole_ms)
        self.assertEqual(closer, {})

    def test_a_frame_whose_way_is_not_known_has_no_parts(self):
        self.assertIsNone(self.one(self.PACKETS[1:])[0])
        self.assertIsNone(self.one(self.PACKETS[:3])[0])
        frame, = self.frames(row(1, 100))
        self.assertIsNone(parts.parts_of(frame, {}, {}, None))

    def test_lateness_counts_from_the_grid_of_intended_times(self):
        frames = self.frames(row(0, 101) + row(1, 150) + row(2, 207.5))
        self.assertEqual(parts.note_lateness(frames, PERIOD), 3)
        self.assertEqual([frame.late / MS for frame in frames], [1, 0, 7.5])
        self.assertAlmostEqual(frames[2].whole_ms, 9.5)

    def test_a_frame_that_is_made_up_for_is_as_late_as_it_is_and_makes_no_other_one_early(self):
        frames = self.frames("".join(row(*each) for each in enumerate((100, 150, 275, 277, 300, 350))))
        self.assertEqual(parts.note_lateness(frames, PERIOD), 6)
        self.assertEqual([frame.late / MS for frame in frames], [0, 0, 75, 27, 0, 0])

    def test_a_frame_that_was_left_out_is_missing_in_the_grid(self):
        frames = self.frames("".join(row(*each) for each in enumerate((100, 1350, 1355, 1400))))
        self.assertEqual(parts.note_lateness(frames, PERIOD), 27)
        self.assertEqual([frame.late / MS for frame in frames], [0, 1200, 5, 0])
        self.assertEqual(parts.note_lateness([], PERIOD), 0)

    def test_no_frame_is_early_when_those_behind_a_gap_are_the_least_late(self):
        frames = self.frames("".join(row(*each) for each in enumerate((103, 1353, 1356, 1400))))
        self.assertEqual(parts.note_lateness(frames, PERIOD), 27)
        self.assertEqual([frame.late / MS for frame in frames], [3, 1203, 6, 0])

    def test_the_slowest_hundredth_is_taken_apart(self):
        frames = self.frames("".join(row(index, 100 + 50 * index, latency_us=str(2000 + index)) for index in range(200)))
        known = [({parts.BACK: float(index)}, {}) for index in range(200)]
        self.assertEqual(parts.slowest(frames, known), {parts.BACK: 198.5})
        self.assertEqual(parts.slowest(frames[:2], known[:2]), {parts.BACK: 1})
        self.assertEqual(parts.slowest([], []), {})

    def test_half_a_line_is_not_read(self):
        self.assertEqual(len(self.frames(row(0, 100) + "1,10")), 1)
        self.assertEqual(parts.read_trace(self.folder / "none.csv"), [])

    def test_statistics(self):
        point = parts.statistics_of([3.0, 1.0, 2.0], lost=1)
        self.assertEqual((point["mean_ms"], point["p50_ms"], point["p99_ms"], point["max_ms"], point["n"], point["lost"]),
                         (2, 2, 3, 3, 3, 1))
        self.assertAlmostEqual(point["stddev_ms"], (2 / 3) ** 0.5)
        self.assertIn("failed", parts.statistics_of([], lost=5))


class TapTest(unittest.TestCase):
    @staticmethod
    def frame(source, destination, payload):
        network = struct.pack("!BBHIBBH8x", 0x45, 0, 40 + len(payload), 0, 64, 6, 0)
        return bytes(12) + b"\x08\x00" + network + struct.pack("!HHIIBBHI", source, destination, 0, 0, 0x50, 0, 0, 0) + payload

    def test_says_which_way_and_how_much(self):
        self.assertEqual(tap.parse(self.frame(40000, 5672, b"abc"), 5672), (True, 40000, 3, b"abc"))
        self.assertEqual(tap.parse(self.frame(5672, 40000, b"abc"), 5672), (False, 40000, 3, b"abc"))
        self.assertIsNone(tap.parse(self.frame(5672, 40000, b""), 5672))


class FigureTest(unittest.TestCase):
    def setUp(self):
        out = contextlib.redirect_stdout(io.StringIO())
        self.out = out.__enter__()
        self.addCleanup(out.__exit__, None, None, None)

    def judged(self, whole_ms, known, lost=0):
        frame = parts.Frame({"seq": "0", "time_ms": "1", "monotonic_us": "0", "render_us": "0", "encode_us": "0",
                             "payload_bytes": "56000", "answered": "1", "latency_us": str(whole_ms * 1000)})
        line = {**parts.statistics_of([whole_ms], lost), "others_cpu": 0.0}
        pair, report = Pair("figure 12"), Report()
        pair.ours, pair.theirs = [line], [line]
        return FIGURE.judge(pair, [frame], [(frame, each) for each in known], report), report

    KNOWN = ({name: 0.1 for name in parts.PARTS}, {parts.IN_BROKER: 0.05})

    def test_targets_are_of_all_frames(self):
        met = [[result["met"] for result in self.judged(whole, [self.KNOWN])[1].results if result["target"]]
               for whole in (2, 3, 6)]
        self.assertEqual(met, [[True, True], [False, True], [False, False]])

    def test_a_lost_frame_fails_and_is_counted(self):
        plots, report = self.judged(2, [self.KNOWN], lost=1)
        self.assertTrue(report.failed)
        whole = next(series for series in plots[0]["series"] if series["kind"] == "ours")
        self.assertEqual(whole["points"][0]["lost"], 1)

    def test_draws_each_part_and_what_is_beside(self):
        plots, _ = self.judged(2, [self.KNOWN])
        self.assertEqual([series["name"] for series in plots[0]["series"] if series["kind"] == "part"], list(parts.PARTS))
        self.assertEqual([series["kind"] for series in plots[0]["series"]][-4:], ["ours", "limit", "paper", "paper"])
        self.assertEqual([series["name"] for series in plots[1]["series"]], [parts.IN_BROKER])
        self.assertEqual(plots[2]["series"][0]["points"], [{"x": 0, "ms": 2.0}])

    def test_says_of_how_many_frames_not_all_is_known(self):
        plots, _ = self.judged(2, [])
        self.assertIn("of 1 of 1 frames a time stamp is missing", self.out.getvalue())
        self.assertEqual([series["kind"] for series in plots[0]["series"]], ["ours", "limit", "paper", "paper"])

    def test_the_topology_is_the_examples_with_time_stamps(self):
        text = figure.stamped("/lib.so", "/stamps")
        self.assertIn('topology.library: "/lib.so"', text)
        self.assertEqual(text.count('stamps: "/stamps"'), 2)
        self.assertIn('zk.servers: ["{zookeeper}"]', text)

    def test_on_storm_it_is_the_examples_for_a_driver_of_its_own(self):
        text = on_storm.topology_on_storm("/lib.so")
        self.assertIn('topology.library: "/lib.so"', text)
        self.assertEqual(text.count(f'driver: "{on_storm.DRIVER}"'), 2)
        self.assertNotIn('driver: "turtle"', text)

    def judged_on_storm(self, whole_ms, lost=0):
        frame = parts.Frame({"seq": "0", "time_ms": "1", "monotonic_us": "0", "render_us": "0", "encode_us": "0",
                             "payload_bytes": "56000", "answered": "1", "latency_us": str(whole_ms * 1000)})
        line = {**parts.statistics_of([whole_ms], lost), "frames": [frame], "others_cpu": 0.0}
        pair, report = Pair("on Storm"), Report()
        pair.ours, pair.theirs = [line], [line]
        return ON_STORM.judge(pair, report), report

    def test_on_storm_targets_are_of_all_frames_and_our_worker_is_beside(self):
        met = [[result["met"] for result in self.judged_on_storm(whole)[1].results if result["target"]] for whole in (3, 5, 13)]
        self.assertEqual(met, [[True, True], [False, True], [False, False]])
        plots, report = self.judged_on_storm(3)
        self.assertEqual({result["baseline"] for result in report.results if result["baseline"]}, {on_storm.OWN})
        self.assertEqual([series["kind"] for series in plots[0]["series"]], ["ours", "limit"])
        self.assertTrue(self.judged_on_storm(3, lost=1)[1].failed)

    def judged_placed(self, ours_ms, theirs_ms, in_worker=((1.0,), (2.0,)), lost=0, alone=None):
        def lines_of(whole):
            frames = [parts.Frame({"seq": "0", "time_ms": "1", "monotonic_us": "0", "render_us": "0", "encode_us": "0",
                                   "payload_bytes": "56000", "answered": "1", "latency_us": str(round(each * 1000))}) for each in whole]
            return [{**parts.statistics_of(whole, lost), "frames": frames, "others_cpu": 0.0}]
        pair, report = Pair("busy"), Report()
        pair.ours, pair.theirs = lines_of(ours_ms), lines_of(theirs_ms)
        if alone:
            PLACED.judge_alone(alone, report, pair, *map(list, in_worker))
        else:
            PLACED.judge(pair, report, *map(list, in_worker))
        return report

    def test_a_placed_worker_stands_beside_one_that_is_not_with_the_thousandth_frame(self):
        report = self.judged_placed([1.0] * 1998 + [5.0, 7.0], [2.0] * 1998 + [20.0, 70.0])
        found = {result["name"]: (result["value"], result["baseline_value"], result["baseline"]) for result in report.results}
        self.assertEqual(found["busy, all frames (2000): p99.9"], (5, 20, placed.USUAL))
        self.assertEqual(found["busy, all frames (2000): max"], (7, 70, placed.USUAL))
        self.assertEqual(found["busy, in the worker (1): p99.9"], (1, 2, placed.USUAL))
        self.assertFalse(report.failed)

    def test_of_a_key_alone_the_tails_are_told(self):
        report = self.judged_placed([1.0] * 1998 + [5.0, 7.0], [2.0] * 1998 + [20.0, 70.0], alone="cores")
        self.assertEqual({result["name"]: result["value"] for result in report.results}, {
            "busy, cores alone, all frames (2000): p99": 1, "busy, cores alone, all frames (2000): p99.9": 5,
            "busy, cores alone, in the worker (1): p99": 1, "busy, cores alone, in the worker (1): p99.9": 1})
        self.assertIn("no frame has all time stamps", self.judged_placed([1.0], [2.0], ((), ()), alone="cores").failed)

    def test_frames_without_a_command_are_told_of_both_and_without_time_stamps_the_run_fails(self):
        report = self.judged_placed([1.0], [2.0], lost=3)
        lost = [result["value"] for result in report.results if "without a command" in result["name"]]
        self.assertEqual(lost, [3, 3])
        self.assertIn("no frame has all time stamps", self.judged_placed([1.0], [2.0], ((), ())).failed)

    def test_how_long_a_frame_was_in_a_worker_is_by_its_own_time_stamps(self):
        with tempfile.TemporaryDirectory() as folder:
            for component, begin, end in (("decode", 12, 13), ("follow", 14, 16)):
                (Path(folder) / f"{component}-3.csv").write_text(f"time_ms,born_ns,begin_ns,end_ns\n7,{11 * MS},{begin * MS},{end * MS}\n")
            frames = [parts.Frame({"seq": "0", "time_ms": str(time), "monotonic_us": "0", "render_us": "0", "encode_us": "0",
                                   "payload_bytes": "1", "answered": "1", "latency_us": "1"}) for time in (7, 8)]
            self.assertEqual(placed.PlacedLoop.in_worker_ms(frames, folder), [5.0])

    @unittest.skipUnless("IOTCLOUD_BUILD" in os.environ, "IOTCLOUD_BUILD names a build with the worker and the bolts")
    def test_the_worker_takes_the_topologies_with_time_stamps(self):
        build = Path(os.environ["IOTCLOUD_BUILD"])
        library = build / "plugins/bench_turtlebot_stamps.so"
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "topology.yaml"
            for text in (figure.stamped(library, folder), placed.placed_topology(library, folder),
                         *(placed.placed_topology(library, folder, each) for each in placed.ALONE.values())):
                file.write_text(text.replace("{zookeeper}", "127.0.0.1:1"))
                done = subprocess.run([build / "bin/iotcloud-topology", "--check", file], capture_output=True, text=True)
                self.assertEqual(done.returncode, 0, done.stderr)
                self.assertIn("class turtlebot.Decoder", done.stdout)


if __name__ == "__main__":
    unittest.main()
