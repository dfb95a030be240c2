#include "iotcloud/brokers/kafka/reading/progress.h"

#include <algorithm>
#include <string_view>

#include <fmt/core.h>

#include <iotcloud/config/number.h>

namespace iotcloud::brokers::kafka {
namespace {

// The text beside a committed offset: "iotcloud1 END HANDED RANGES". END is "end" if the reader ended in order and knew
// how far readers before it may have got, otherwise "on"; HANDED is how many offsets from the committed one on may have
// been handed on; RANGES, such as "2,5-9,", are the settled ones among them, counted in the same way. Any member of the
// group may write any text and any offset there.
constexpr std::string_view mark = "iotcloud1 ";
constexpr std::size_t longest = 3000;  // servers take 4096 bytes
/// No partition has so many records. The sum of two such numbers is a number, too.
constexpr std::int64_t most_records = std::int64_t{1} << 60;

std::string_view take_word(std::string_view& text, char end) {
  const auto at = text.find(end);
  const std::string_view word = text.substr(0, at);
  text.remove_prefix(at == std::string_view::npos ? text.size() : at + 1);
  return word;
}

std::optional<std::int64_t> to_offset(std::string_view text) {
  const auto number = config::parse_number<std::int64_t>(text);
  return number && *number >= 0 && *number <= most_records ? number : std::nullopt;
}

}  // namespace

Progress::Progress(const Committed& committed, std::int64_t handed_on)
    : start_(committed.offset),
      next_(std::max<std::int64_t>(committed.offset, 0)),
      placed_(committed.known),
      handed_on_(handed_on) {
  if (committed.known && committed.offset < 0) return;  // the group has committed nothing for this partition yet
  doubtful_ = true;
  read_metadata(committed);
}

void Progress::read_metadata(const Committed& committed) {
  std::string_view text = committed.metadata;
  if (!text.starts_with(mark) || committed.offset < 0 || committed.offset > most_records) return;
  text.remove_prefix(mark.size());
  const bool ended = take_word(text, ' ') == "end";
  const std::optional<std::int64_t> handed = to_offset(take_word(text, ' '));
  if (!handed) return;
  handed_on_ = std::max(handed_on_, committed.offset + *handed);
  doubtful_ = !ended;
  while (!text.empty()) {
    std::string_view range = take_word(text, ',');
    const std::optional<std::int64_t> first = to_offset(take_word(range, '-'));
    const std::optional<std::int64_t> last = range.empty() ? first : to_offset(range);
    if (!first || !last || *last < *first) return;
    settled_before_.emplace_back(committed.offset + *first, committed.offset + *last);
  }
}

bool Progress::was_settled(std::int64_t offset) const {
  return std::any_of(settled_before_.begin(), settled_before_.end(),
                     [&](const Range& range) { return range.first <= offset && offset <= range.second; });
}

bool Progress::maybe_handed_on(std::int64_t offset, std::int64_t log_end) {
  if (wants_log_end()) doubtful_to_ = log_end;
  return offset < handed_on() || (doubtful_ && offset < *doubtful_to_);
}

void Progress::note(std::int64_t offset) {
  if (offset < next_) settled_before_.clear();  // the topic was deleted and made again
  next_ = offset + 1;
  placed_ = true;
  offsets_.push_back(offset);
}

void Progress::arrived(std::int64_t offset, Message message, bool redelivered) {
  note(offset);
  window_.delivered({std::move(message), redelivered, first_tag_ + offsets_.size() - 1, 0});
}

void Progress::skipped(std::int64_t offset) {
  note(offset);
  window_.skipped();
}

std::int64_t Progress::handed_on() const {
  const std::uint64_t newest = window_.newest_handed_on();
  return newest < first_tag_ ? handed_on_ : std::max(handed_on_, offsets_[newest - first_tag_] + 1);
}

std::optional<Committed> Progress::to_commit(bool final) {
  if (!placed_) return std::nullopt;
  handed_on_ = handed_on();
  const std::uint64_t first = window_.advance();
  for (; first_tag_ < first; ++first_tag_) offsets_.pop_front();
  const std::int64_t offset = offsets_.empty() ? next_ : offsets_.front();
  std::pair<std::int64_t, std::string> now(offset, metadata(offset, final));
  if (committed_ == now) return std::nullopt;
  committed_ = std::move(now);
  return Committed{committed_->first, committed_->second};
}

std::string Progress::metadata(std::int64_t offset, bool final) const {
  // An orderly end takes no doubt away that a reader before left, which ended without a farewell.
  const bool ended = final && !wants_log_end();
  const std::int64_t newest = std::max(handed_on(), doubtful_to_.value_or(0));
  const std::int64_t handed = ended ? std::max<std::int64_t>(newest - offset, 0) : 0;
  std::string text = fmt::format("{}{} {} ", mark, ended ? "end" : "on", handed);
  if (window_.settled() == 0) return text;
  for (std::size_t i = 0; i < offsets_.size() && text.size() < longest; ++i) {
    if (!window_.is_settled(first_tag_ + i)) continue;
    const std::size_t begin = i;
    while (i + 1 < offsets_.size() && window_.is_settled(first_tag_ + i + 1)) ++i;
    text += begin == i ? fmt::format("{},", offsets_[i] - offset)
                       : fmt::format("{}-{},", offsets_[begin] - offset, offsets_[i] - offset);
  }
  return text;
}

}  // namespace iotcloud::brokers::kafka
