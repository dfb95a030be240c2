#!/usr/bin/python3
"""Clang's analysis finds what `config/mutex.h` and `config/thread_safety.h` are there to find, and nothing else: what
`./dev lint` runs before it believes that a file is clean.

usage: lint_self_test.py --build FOLDER      FOLDER: configured; its include/iotcloud is the tree
"""
import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# Each line that ends in `// finds: WORDS` gets a finding with these words, and no other line gets any.
SOURCE = r"""
#include <mutex>

#include <iotcloud/config/mutex.h>

namespace iotcloud::config {

class Counter {
 public:
  void add() {
    const MutexLock lock(mutex_);
    ++value_;
  }
  void add_without() {
    ++value_;  // finds: requires holding mutex 'mutex_'
  }
  void add_with_a_lock_that_the_analysis_does_not_know() {
    const std::lock_guard lock(mutex_);
    ++value_;  // finds: requires holding mutex 'mutex_'
  }
  void add_locked() IOTCLOUD_REQUIRES(mutex_) { ++value_; }
  void call_it_without() {
    add_locked();  // finds: requires holding mutex 'mutex_'
  }
  void call_it_with() {
    UniqueLock lock(mutex_);
    add_locked();
    lock.unlock();
    report();
    lock.lock();
    add_locked();
    {
      const Unlocked unlocked(mutex_);
      report();
    }
    add_locked();
  }
  void call_it_after_giving_back() {
    UniqueLock lock(mutex_);
    lock.unlock();
    add_locked();  // finds: requires holding mutex 'mutex_'
  }
  void give_back_for_a_call() IOTCLOUD_REQUIRES(mutex_) {
    const Unlocked unlocked(mutex_);
    report();
    ++value_;  // finds: requires holding mutex 'mutex_'
  }
  void call_foreign_code_with_it() {
    const MutexLock lock(mutex_);
    report();  // finds: cannot call function 'report' while mutex 'mutex_' is held
  }
  int wait(Clock::Instant end) {
    const MutexLock lock(mutex_);
    changed_.wait_until(mutex_, end, [this]() IOTCLOUD_REQUIRES(mutex_) { return value_ > 0; });
    stoppable_.wait_until(mutex_, end, [this] {
      mutex_.assert_held();
      return value_ > 0;
    });
    return value_;
  }
  void wait_without() {
    changed_.wait(mutex_);  // finds: requires holding mutex 'mutex_'
  }
  void leave_it_held() {
    mutex_.lock();
  }  // finds: mutex 'mutex_' is still held at the end of function
  int read() {
    const ReadLock lock(shared_);
    return many_;
  }
  void write() {
    const WriteLock lock(shared_);
    ++many_;
  }
  void write_while_reading() {
    const ReadLock lock(shared_);
    ++many_;  // finds: requires holding shared mutex 'shared_' exclusively
  }
  void run() {
    thread_.assert_held();
    step();
  }
  void step() IOTCLOUD_REQUIRES(thread_) { ++steps_; }
  void step_elsewhere() {
    step();  // finds: requires holding thread 'thread_'
  }

 private:
  void report() IOTCLOUD_EXCLUDES(mutex_) {}
  Mutex mutex_;
  ConditionVariable changed_;
  StoppableConditionVariable stoppable_;
  SharedMutex shared_;
  ThreadRole thread_;
  int value_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  int many_ IOTCLOUD_GUARDED_BY(shared_) = 0;
  int steps_ IOTCLOUD_GUARDED_BY(thread_) = 0;
};

}  // namespace iotcloud::config
"""


def findings(build):
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "counter.cc"
        source.write_text(SOURCE)
        command = ["clang-tidy-14", "--quiet", f"--config-file={ROOT / '.clang-tidy'}", str(source), "--", "-std=c++20",
                   f"-I{build.resolve() / 'include'}"]
        said = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                              text=True, check=False).stdout
    found = [(int(line), text) for line, text in re.findall(r"counter\.cc:(\d+):\d+: (?:error|warning): (.*)", said)]
    return found, said


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--build", type=Path, required=True)
    found, said = findings(parser.parse_args().build)
    expected = {number: line.split("// finds: ")[1]
                for number, line in enumerate(SOURCE.splitlines(), 1) if "// finds: " in line}
    problems = [f"line {number} has a finding: {text}" for number, text in found if number not in expected]
    for number, words in expected.items():
        if not any(line == number and words in text for line, text in found):
            problems.append(f"line {number} has no finding with \"{words}\"")
    if problems:
        print("lint does not see what it should:", *problems, said, sep="\n")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
