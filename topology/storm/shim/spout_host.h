#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include <iotcloud/topology/spout.h>
#include <iotcloud/topology/storm/shim/task_host.h>

namespace iotcloud::topology::storm {

/// A spout's task. Its component's SpoutWaker wakes Storm's executor.
class SpoutHost final : public TaskHost, private SpoutOutputCollector {
 public:
  SpoutHost(const TaskDescription& task, Component component, std::span<std::byte> buffer, CommandSink& sink);

  std::size_t activate();
  std::size_t deactivate();
  std::size_t next_tuple();
  /// \param took since the message was emitted
  /// \param times of so many messages, of which Java measured this one; 0: it did not measure it
  std::size_t ack(MessageId id, std::chrono::nanoseconds took, std::uint64_t times = 1);
  std::size_t fail(MessageId id);

 private:
  void open_component() override;
  void close_component() override;
  template <typename Call>
  std::size_t run(std::string_view what, Call&& call);
  void do_emit(std::string_view stream, Values&& values, int task, const MessageId* id) override;
  void report_error(const std::string& text) override;

  std::shared_ptr<SpoutWaker::Target> waker_;
  std::unique_ptr<Spout> spout_;
  config::Histogram& complete_;
};

}  // namespace iotcloud::topology::storm
