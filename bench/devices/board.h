#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string_view>

#include <iotcloud/bench/harness/latency_histogram.h>

namespace iotcloud::bench {

/// The head of a reading's bytes; its topic says of which device it is.
struct Reading {
  std::int64_t run = 0;     ///< which load it belongs to; each has a board of its own
  std::int64_t due_ns = 0;  ///< when it was to be sent, as now_ns() counts
  std::uint64_t number = 0;

  /// \return false if the bytes are none
  static bool parse(std::string_view bytes, Reading& reading);
};

/// What one listener has heard of the readings of a run, and when: a file that the processes concerned have mapped, so
/// that a listener's work costs it a store. Any number of threads may take(); a board must not be destroyed meanwhile.
class Board {
 public:
  /// Makes the file, for readings with numbers below `most`. \throws std::system_error
  Board(const std::filesystem::path& file, std::uint64_t most);
  /// The file that another process made. \throws std::system_error
  explicit Board(const std::filesystem::path& file);
  ~Board();
  Board(const Board&) = delete;
  Board& operator=(const Board&) = delete;

  /// Where that of the topology is for a run, in a folder that both processes know.
  static std::filesystem::path file(const std::filesystem::path& folder, std::int64_t run);

  /// Notes that a reading is heard now; one with a number of no place is left out.
  void take(const Reading& reading);
  /// Number of readings that were heard at least once.
  std::uint64_t count() const { return head_->count; }
  /// Number of times that one was heard again.
  std::uint64_t again() const { return head_->again; }
  /// Latencies, from when a reading was due until it was first heard, of those with numbers from `first` on.
  LatencyHistogram::Summary summary(std::uint64_t first) const;

 private:
  struct Head {
    std::atomic<std::uint64_t> count, again;
  };
  void map(int descriptor);

  Head* head_ = nullptr;
  std::atomic<std::int64_t>* latencies_ = nullptr;  ///< ns by number, at least 1; 0: not heard
  std::uint64_t most_ = 0;
};

}  // namespace iotcloud::bench
