#include <algorithm>
#include <stdexcept>
#include <utility>

#include <poll.h>

#include <iotcloud/config/declaration.h>
#include <iotcloud/drivers/channel_names.h>
#include <iotcloud/drivers/testing/mock_host.h>

namespace iotcloud::drivers::testing {

PublishStatus MockHost::publish(std::string_view channel, Message message) noexcept {
  Published published{std::string(channel), std::move(message)};
  published.message.driver_id = instance_id_;
  published.message.gateway_id = gateway_id_;
  if (published.message.time_ms == 0) published.message.time_ms = 1 + now_.count() / 1000;
  {
    const config::MutexLock lock(mutex_);
    if (channels_) {
      if (const std::string problem = unknown_channel(channel, Direction::out, *channels_); !problem.empty()) {
        if (!std::exchange(failed_, true)) failure_ = problem;
        return PublishStatus::closed;
      }
    }
    if (const auto answer = answers_.find(channel); answer != answers_.end()) {
      if (answer->second != PublishStatus::accepted) return answer->second;
    }
    published_.push_back(published);
  }
  if (on_publish_) on_publish_(published);
  return PublishStatus::accepted;
}

HandlerId MockHost::start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                                std::function<void()> callback) noexcept {
  timers_[next_id_] = {now_ + first, period, std::move(callback)};
  return next_id_++;
}

HandlerId MockHost::watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback) noexcept {
  watches_[next_id_] = {descriptor, for_writing, std::move(callback)};
  return next_id_++;
}

void MockHost::stop_handler(HandlerId id) noexcept {
  timers_.erase(id);
  watches_.erase(id);
}

void MockHost::post(std::function<void()> callback) noexcept {
  const config::MutexLock lock(mutex_);
  posted_.push_back(std::move(callback));
}

void MockHost::log(LogLevel level, std::string_view text) noexcept {
  const config::MutexLock lock(mutex_);
  logged_.push_back({level, std::string(text)});
}

void MockHost::report_found(std::string_view key, const PropertyMap& attributes) noexcept {
  const config::MutexLock lock(mutex_);
  found_.insert_or_assign(std::string(key), attributes);
}

void MockHost::report_gone(std::string_view key) noexcept {
  const config::MutexLock lock(mutex_);
  found_.erase(std::string(key));
}

void MockHost::report_sight(bool sees) noexcept {
  const config::MutexLock lock(mutex_);
  if (sees && !sees_) found_.clear();
  sees_ = sees;
}

std::map<std::string, PropertyMap> MockHost::found() const {
  const config::MutexLock lock(mutex_);
  return found_;
}

bool MockHost::sees() const {
  const config::MutexLock lock(mutex_);
  return sees_;
}

void MockHost::fail(std::string_view reason) noexcept {
  const config::MutexLock lock(mutex_);
  if (!failed_) failure_ = reason;
  failed_ = true;
}

void MockHost::advance(std::chrono::microseconds duration) {
  const auto end = now_ + duration;
  for (;;) {
    run_posted();
    const auto next = std::min_element(timers_.begin(), timers_.end(), [](const auto& a, const auto& b) {
      return a.second.due < b.second.due;  // among equals the one that was started first
    });
    if (next == timers_.end() || next->second.due > end) break;
    now_ = std::max(now_, next->second.due);
    const auto callback = next->second.callback;  // a copy: the callback may stop its own timer
    if (next->second.period.count() > 0) {
      next->second.due += next->second.period;
    } else {
      timers_.erase(next);
    }
    callback();
  }
  now_ = end;
}

std::size_t MockHost::run_posted(std::size_t limit) {
  std::size_t count = 0;
  while (count < limit) {
    std::vector<std::function<void()>> ready;
    {
      const config::MutexLock lock(mutex_);
      ready.swap(posted_);
    }
    if (ready.empty()) break;
    for (const auto& callback : ready) callback();
    count += ready.size();
  }
  return count;
}

std::size_t MockHost::poll_descriptors(std::chrono::milliseconds limit) {
  std::vector<pollfd> descriptors;
  std::vector<HandlerId> ids;
  for (const auto& [id, watch] : watches_) {
    descriptors.push_back({watch.descriptor, static_cast<short>(watch.for_writing ? POLLOUT : POLLIN), 0});
    ids.push_back(id);
  }
  if (poll(descriptors.data(), descriptors.size(), static_cast<int>(limit.count())) <= 0) return 0;
  std::size_t count = 0;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const auto watch = watches_.find(ids[i]);  // gone when an earlier callback stopped it
    if (descriptors[i].revents == 0 || watch == watches_.end()) continue;
    const auto callback = watch->second.callback;
    callback();
    ++count;
  }
  return count;
}

void MockHost::declare_channels(std::vector<ChannelSpec> channels) {
  const config::MutexLock lock(mutex_);
  channels_ = std::move(channels);
}

void MockHost::answer_publish(const std::string& channel, PublishStatus status) {
  const config::MutexLock lock(mutex_);
  answers_[channel] = status;
}

void MockHost::drop_handlers() {
  timers_.clear();
  watches_.clear();
  const config::MutexLock lock(mutex_);
  posted_.clear();
}

std::vector<MockHost::Published> MockHost::published() const {
  const config::MutexLock lock(mutex_);
  return published_;
}

std::vector<MockHost::Published> MockHost::published(std::string_view channel) const {
  std::vector<Published> selected = published();
  std::erase_if(selected, [&](const Published& p) { return p.channel != channel; });
  return selected;
}

void MockHost::forget_published() {
  const config::MutexLock lock(mutex_);
  published_.clear();
}

std::vector<MockHost::Logged> MockHost::logged() const {
  const config::MutexLock lock(mutex_);
  return logged_;
}

std::size_t MockHost::logged_count(std::string_view text) const {
  const std::vector<Logged> lines = logged();
  return static_cast<std::size_t>(std::count_if(
      lines.begin(), lines.end(), [&](const Logged& line) { return line.text.find(text) != std::string::npos; }));
}

void MockHost::update_metadata(const PropertyMap& changes) noexcept {
  const config::MutexLock lock(mutex_);
  for (const auto& [key, value] : changes) {
    if (value.empty()) {
      metadata_.erase(key);
    } else {
      metadata_[key] = value;
    }
  }
}

PropertyMap MockHost::metadata() const {
  const config::MutexLock lock(mutex_);
  return metadata_;
}

bool MockHost::failed() const {
  const config::MutexLock lock(mutex_);
  return failed_;
}

std::string MockHost::failure() const {
  const config::MutexLock lock(mutex_);
  return failure_;
}

MockInstance::MockInstance(const Descriptor& descriptor, PropertyMap properties)
    : descriptor_(descriptor),
      host_(config::with_defaults(std::move(properties), config::declaration_of(descriptor.declaration))),
      shell_(descriptor_.create()) {
  if (!shell_) error_ = "the driver's constructor threw";
}

MockInstance::~MockInstance() {
  close();
  if (shell_) descriptor_.destroy(shell_);
}

bool MockInstance::note(const std::string& error) {
  if (error_.empty()) error_ = error;
  return error.empty();
}

bool MockInstance::start() {
  return open() && activate();
}

bool MockInstance::open() {
  if (!shell_) return false;
  if (!note(config::text_of(config::problems_of(host_.properties(), config::declaration_of(descriptor_.declaration)))))
    return false;
  std::string error;
  channels_ = shell_->channels(host_.properties(), error);
  if (!note(error)) return false;
  host_.declare_channels(channels_);
  opened_ = true;
  shell_->open(host_, error);
  return note(error);
}

bool MockInstance::activate() {
  std::string error;
  shell_->activate(error);
  return note(error);
}

bool MockInstance::deactivate() {
  std::string error;
  shell_->deactivate(error);
  return note(error);
}

void MockInstance::require(std::string_view channel, Direction direction) const {
  if (!opened_) return;
  const std::string problem = unknown_channel(channel, direction, channels_);
  if (!problem.empty()) throw std::invalid_argument(problem);
}

bool MockInstance::deliver(std::string_view channel, Message message) {
  require(channel, Direction::in);
  std::string error;
  shell_->on_message(channel, std::move(message), error);
  host_.run_posted();
  return note(error);
}

bool MockInstance::writable(std::string_view channel) {
  require(channel, Direction::out);
  std::string error;
  shell_->on_writable(channel, error);
  host_.run_posted();
  return note(error);
}

bool MockInstance::stored(std::string_view channel, std::uint64_t count) {
  require(channel, Direction::out);
  std::string error;
  shell_->on_stored(channel, count, error);
  host_.run_posted();
  return note(error);
}

void MockInstance::close() {
  if (!shell_ || !opened_) return;
  opened_ = false;
  host_.drop_handlers();
  std::string error;
  shell_->close(error);
  note(error);
}

}  // namespace iotcloud::drivers::testing
