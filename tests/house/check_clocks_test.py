#!/usr/bin/python3
"""The checker finds what it is there to find, and nothing else."""

import unittest

import check_clocks


class CheckClocks(unittest.TestCase):
    def problems(self, line, file="gateway/a.cc"):
        return list(check_clocks.check_source(file, f"#include <chrono>\n{line}\n"))

    def assert_refused(self, line, file="gateway/a.cc"):
        problems = self.problems(line, file)
        self.assertEqual(len(problems), 1, line)
        self.assertTrue(problems[0].startswith(f"{file}:{2 + line.count(chr(10))}: "), problems[0])

    def assert_allowed(self, line, file="gateway/a.cc"):
        self.assertEqual(self.problems(line, file), [], line)

    def test_waits_on_the_wall_clock(self):
        self.assert_refused("changed_.wait_until(lock, std::chrono::system_clock::now() + limit);")
        self.assert_refused("future.wait_until(system_clock::now() + limit);")
        self.assert_refused("std::this_thread::sleep_until(std::chrono::system_clock::now() + 1s);")
        self.assert_refused("using Time = std::chrono::system_clock::time_point;")
        self.assert_refused("using std::chrono::system_clock;")
        self.assert_refused("const auto began = std::chrono::high_resolution_clock::now();")

    def test_waits_that_an_injected_clock_does_not_move(self):
        for line in ("changed_.wait_for(mutex_, pause);", "end->wait_for(limit);",
                     "std::this_thread::sleep_for(std::chrono::milliseconds(5));",
                     "const auto end = std::chrono::steady_clock::now() + limit;",
                     "using std::chrono::steady_clock;", "const auto now = steady_clock::now();"):
            for file in ("brokers/rabbitmq/a.cc", "topology/state/redis/a.h"):
                self.assert_refused(line, file)
            self.assert_allowed(line)
            self.assert_allowed(line, "tests/brokers/a.cc")
        for line in ("changed_.wait_until(mutex_, clock_, clock_.now() + pause);", "changed_.wait(mutex_);",
                     "AwaitedRecord wait_for(const Condition& condition);", "auto left = remaining_steady_clock();"):
            self.assert_allowed(line, "brokers/rabbitmq/a.cc")

    def test_looks_at_the_machines_clock_where_one_is_injected(self):
        for file in ("brokers/a.cc", "topology/state/a.cc", "master/a.cc"):
            self.assert_refused("if (config::system_clock().now() < again_at_) return;", file)
            self.assert_allowed("explicit Pool(const config::Clock& clock = config::system_clock());", file)
            self.assert_allowed("clock_(options.clock != nullptr ? *options.clock : config::system_clock())", file)

    def test_waits_of_the_operating_system_that_take_no_other(self):
        self.assert_refused("pthread_cond_timedwait(&condition, &mutex, &end);")
        self.assert_refused("sem_timedwait(&semaphore, &end);")
        self.assert_refused("clock_gettime(CLOCK_REALTIME, &now);")
        self.assert_refused("gettimeofday(&now, nullptr);")
        self.assert_refused("const auto now = time(nullptr);")
        self.assert_refused("const std::time_t now = std::time(nullptr);")

    def test_time_spans_between_time_stamps(self):
        self.assert_refused("const auto took = clock.wall_ms() - began_ms;")
        self.assert_refused("if (options_.clock->wall_ms() > end_ms) return;")
        self.assert_refused("if (end_ms <= options_.clock->wall_ms()) return;")
        self.assert_refused("if (now_ms() - record->accepted_ms >= limit) return;")
        self.assert_refused("if (now_ms - link.since_ms < grace.count()) return;")

    def test_time_spans_by_a_variable_that_holds_a_time_stamp(self):
        for declaration in ("const std::int64_t now = clock_.wall_ms();", "const auto now{options_.clock->wall_ms()};",
                            "now = config::system_clock().wall_ms();"):
            self.assert_refused(f"{declaration}\nif (now - link.since_ms < grace.count()) return;")
            self.assert_refused(f"{declaration}\nif (link.since_ms + grace.count() > now) return;")
            self.assert_allowed(f"{declaration}\nrecord.since_ms = now;\nsay(now, clock_.now() - began);")
        self.assert_allowed("const auto now = clock_.now();\nif (now - began < grace) return;")

    def test_time_spans_in_python(self):
        for line in ("while time.time() < end:", "took = time.time() - began", "until = limit + time.time()",
                     "if began <= time.time():"):
            problems = list(check_clocks.check_python("tests/a.py", f"import time\n{line}\n"))
            self.assertEqual(len(problems), 1, line)
            self.assertTrue(problems[0].startswith("tests/a.py:2: "), problems[0])
        for line in ("kills.append((time.time(), victim))", "while time.monotonic() < end:", "seed = int(time.time())",
                     "pass  # not time.time() - began"):
            self.assertEqual(list(check_clocks.check_python("tests/a.py", line)), [], line)

    def test_what_is_right_is_let_pass(self):
        self.assert_allowed("clock_.set_wall_ms(clock_.wall_ms() - an_hour_ms);")
        self.assert_allowed("changed_.wait_until(lock, std::chrono::steady_clock::now() + limit);")
        self.assert_allowed("changed_.wait_for(lock, limit);")
        self.assert_allowed("const auto& clock = config::system_clock();")
        self.assert_allowed("record.since_ms = options_.clock->wall_ms();")
        self.assert_allowed("say(name, clock->wall_ms());")
        self.assert_allowed("pthread_cond_clockwait(&condition, &mutex, CLOCK_MONOTONIC, &end);")
        self.assert_allowed("const auto left = remaining_time(nullptr);")
        self.assert_allowed("std::int64_t wall_ms() const override { return 1 + ms_; }")

    def test_comments_say_what_they_like(self):
        self.assert_allowed("// std::chrono::system_clock::now() is not for waits")
        self.assert_allowed("/* sem_timedwait(a, b)\n std::chrono::system_clock */")

    def test_each_exception_says_why_and_is_for_its_file_alone(self):
        for file, reason in {**check_clocks.TIME_OF_DAY, **check_clocks.STAMPS_OF_OTHERS,
                             **check_clocks.OF_THE_MACHINE}.items():
            self.assertTrue(reason, file)
        self.assertFalse(self.problems("end.wait_for(limit);", "brokers/kafka/client.cc"))
        self.assertFalse(self.problems("std::chrono::system_clock::now();", "config/clock.cc"))
        self.assertTrue(self.problems("std::chrono::system_clock::now();", "config/other.cc"))


if __name__ == "__main__":
    unittest.main()
