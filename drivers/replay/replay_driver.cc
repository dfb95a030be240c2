#include <algorithm>
#include <set>
#include <stdexcept>

#include <iotcloud/drivers/replay/replay_driver.h>

namespace iotcloud::drivers::replay {

namespace {

/// How many messages are sent before other instances of the host have their turn; and how many of other instances are
/// passed over.
constexpr int most_at_once = 100, most_read_at_once = 10'000;

std::string words(const recording::RecordedChannel& channel) {
  if (channel.instance.empty()) return "(of no instance)";
  return channel.alias.empty() ? channel.instance : channel.alias + " (" + channel.instance + ")";
}

std::string text(const PropertyMap& properties, const std::string& name) {
  const auto found = properties.find(name);
  return found == properties.end() ? std::string() : found->second;
}

}  // namespace

void ReplayDriver::find_instance(const std::string& word) {
  std::set<std::pair<std::string, std::string>> found;
  std::set<std::string> all;
  for (const auto& channel : recording_->channels()) {
    all.insert(words(channel));
    if (word.empty() || recording::names_instance(channel, word)) found.emplace(channel.driver, channel.instance);
  }
  std::string list;
  for (const auto& one : all) list += (list.empty() ? "" : ", ") + one;
  if (all.empty()) throw std::invalid_argument("property \"file\": the recording has no channel");
  if (found.empty())
    throw std::invalid_argument("property \"instance\": no instance \"" + word + "\" was recorded; there are: " + list);
  if (found.size() > 1)
    throw std::invalid_argument("property \"instance\": " +
                                (word.empty() ? "several instances were recorded" : "\"" + word + "\" names several") +
                                "; say which: " + list);
  driver_ = found.begin()->first;
  instance_ = found.begin()->second;
}

bool ReplayDriver::plays(std::size_t channel) const {
  const auto& of = recording_->channels()[channel];
  return of.driver == driver_ && of.instance == instance_;
}

std::vector<ChannelSpec> ReplayDriver::channels(const PropertyMap& properties) {
  const std::string file = text(properties, "file");
  if (file.empty()) throw std::invalid_argument("property \"file\": name the recording");
  recording_ = std::make_unique<recording::RecordingReader>(file);
  find_instance(text(properties, "instance"));
  std::vector<ChannelSpec> specs;
  for (std::size_t i = 0; i < recording_->channels().size(); ++i) {
    if (!plays(i)) continue;
    const auto& channel = recording_->channels()[i];
    ChannelSpec spec;
    spec.name = channel.name;
    spec.direction = channel.out ? Direction::out : Direction::in;
    spec.shared = channel.shared;
    specs.push_back(std::move(spec));
  }
  return specs;
}

void ReplayDriver::open(DriverContext& context) {
  context_ = &context;
  speed_ = context.number("speed");
  loop_ = context.flag("loop");
  now_ = context.property("times") == "now";
  if (const auto& problem = recording_->file().problem(); !problem.empty())
    context.log(LogLevel::warn, "the recording: " + problem);
  PropertyMap metadata;
  for (std::size_t i = 0; i < recording_->channels().size(); ++i) {
    if (plays(i)) metadata.insert(recording_->channels()[i].metadata.begin(), recording_->channels()[i].metadata.end());
  }
  if (!metadata.empty()) context.update_metadata(metadata);
}

void ReplayDriver::activate() {
  active_ = true;
  blocked_ = false;
  pace_.reset();
  send_due();
}

void ReplayDriver::deactivate() {
  active_ = false;
  if (timer_) context_->stop(*timer_);
  timer_.reset();
}

void ReplayDriver::close() {
  if (context_ == nullptr) return;
  context_->log(LogLevel::info, "played " + std::to_string(sent_) + " messages, took " + std::to_string(received_));
  recording_.reset();
}

ReplayDriver::Fetched ReplayDriver::fetch() {
  for (int read = 0; !next_; ++read) {
    if (read == most_read_at_once) return Fetched::later;
    next_ = recording_->next();
    if (next_) {
      const auto& channel = recording_->channels()[next_->channel];
      if (!channel.out || !plays(next_->channel)) next_.reset();
      continue;
    }
    // The end. A recording without a message of this instance has no second round.
    if (!loop_ || of_round_ == 0) return Fetched::none;
    of_round_ = 0;
    recording_->rewind();
    pace_.reset();
  }
  return Fetched::message;
}

void ReplayDriver::end() {
  ended_ = true;
  context_->log(LogLevel::info, "the recording has ended: " + std::to_string(sent_) + " messages were played");
}

void ReplayDriver::send_due() {
  timer_.reset();
  for (int count = 0; active_ && !blocked_ && !ended_; ++count) {
    const Fetched fetched = fetch();
    if (fetched == Fetched::none) return end();
    if (fetched == Fetched::later) {
      timer_ = context_->after(std::chrono::microseconds{0}, [this] { send_due(); });
      return;
    }
    const auto now = clock_();
    if (!pace_) pace_.emplace(next_->at, now, speed_);
    const auto due = pace_->due(next_->at);
    if (due > now || count == most_at_once) {
      const auto wait = std::max(std::chrono::ceil<std::chrono::microseconds>(due - now), std::chrono::microseconds{0});
      timer_ = context_->after(wait, [this] { send_due(); });
      return;
    }
    // A copy: a channel that is full takes the message later.
    Message message = next_->message;
    message.driver_id.clear();
    message.gateway_id.clear();
    if (now_) message.time_ms = 0;  // the host sets it
    switch (context_->publish(recording_->channels()[next_->channel].name, std::move(message))) {
      case PublishStatus::accepted:
        next_.reset();
        ++sent_;
        ++of_round_;
        break;
      case PublishStatus::would_block:
        blocked_ = true;
        break;
      case PublishStatus::closed:
        active_ = false;
        break;
    }
  }
}

void ReplayDriver::on_message(std::string_view, Message) {
  ++received_;
}

void ReplayDriver::on_writable(std::string_view channel) {
  if (!blocked_ || !next_ || recording_->channels()[next_->channel].name != channel) return;
  blocked_ = false;
  if (timer_) context_->stop(*timer_);
  send_due();
}

}  // namespace iotcloud::drivers::replay
