#include <utility>

#include <iotcloud/topology/storm/shim/spout_host.h>

namespace iotcloud::topology::storm {

namespace {

class ExecutorWaker final : public SpoutWaker::Target {
 public:
  explicit ExecutorWaker(CommandSink& sink) : sink_(sink) {}
  void wake() noexcept override { sink_.wake(); }

 private:
  CommandSink& sink_;
};

}  // namespace

SpoutHost::SpoutHost(const TaskDescription& task, Component component, std::span<std::byte> buffer, CommandSink& sink)
    : TaskHost(task, std::move(component), buffer, sink),
      waker_(std::make_shared<ExecutorWaker>(sink)),
      complete_(histogram("iotcloud_spout_complete_seconds", "From emit to the ack of the whole tree")) {
  context_.waker = SpoutWaker(waker_);
  spout_ = spec_.spout();
}

void SpoutHost::open_component() {
  spout_->open(spec_.config, context_, *this);
}

void SpoutHost::close_component() {
  spout_->close();
}

template <typename Call>
std::size_t SpoutHost::run(std::string_view what, Call&& call) {
  const OwnCall own(*this);
  guarded(what, call);
  return commands_.take();
}

std::size_t SpoutHost::activate() {
  return run("activate()", [this] { spout_->activate(); });
}
std::size_t SpoutHost::deactivate() {
  return run("deactivate()", [this] { spout_->deactivate(); });
}
std::size_t SpoutHost::next_tuple() {
  return run("next_tuple()", [this] { spout_->next_tuple(); });
}
std::size_t SpoutHost::ack(MessageId id, std::chrono::nanoseconds took, std::uint64_t times) {
  if (times > 0) complete_.record_ns(took.count(), times);
  return run("ack()", [&] { spout_->ack(id); });
}
std::size_t SpoutHost::fail(MessageId id) {
  return run("fail()", [&] { spout_->fail(id); });
}

void SpoutHost::do_emit(std::string_view stream, Values&& values, int task, const MessageId* id) {
  require_own_call();
  const std::uint16_t number = checked_stream(stream, values, task);
  if (ParcelPtr parcel = pack(number, values, 0)) {
    commands_.emit(number, task, id, std::move(parcel), task_.outputs[number].told);
    return;
  }
  add_birth(number, values, 0);
  commands_.emit(number, task, id, values.all());
}

void SpoutHost::report_error(const std::string& text) {
  require_own_call();
  commands_.error(text);
}

}  // namespace iotcloud::topology::storm
