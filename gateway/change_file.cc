#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/gateway/change_file.h>
#include <iotcloud/gateway/logger.h>

namespace iotcloud::gateway {
namespace {

constexpr std::size_t most_reason_bytes = 2000;  ///< the text comes from the driver and may have any length

std::string line_of(StateChange change) {
  if (change.reason.size() > most_reason_bytes) change.reason.resize(most_reason_bytes);
  // to_text() replaces bytes that are not UTF-8, such as half of a character that resize() cut in two.
  return discovery::to_text(discovery::to_json<nlohmann::json>(change)) + '\n';
}

bool write_all(const processes::OwnedDescriptor& file, const std::string& bytes) {
  for (std::size_t done = 0; done < bytes.size();) {
    const ssize_t written = write(file.get(), bytes.data() + done, bytes.size() - done);
    if (written < 0 && errno != EINTR) return false;
    if (written > 0) done += static_cast<std::size_t>(written);
  }
  return true;
}

}  // namespace

std::deque<StateChange> ChangeFile::load() {
  std::deque<StateChange> changes;
  std::ifstream file(path_, std::ios::binary);
  std::string line;
  std::size_t number = 0;
  try {
    while (std::getline(file, line) && !file.eof()) {  // eof: the line has no line feed, so it is incomplete
      ++number;
      changes.push_back(discovery::from_text<StateChange>(line, path_));
      if (changes.size() > most_) changes.pop_front();
    }
  } catch (const std::exception& e) {
    const std::string aside = path_ + ".damaged";
    std::error_code error;
    std::filesystem::rename(path_, aside, error);
    logger.warn("{}, the history of earlier runs, is damaged in line {} ({}); it is {}, and what stood before is kept",
                path_, number, e.what(), error ? "overwritten" : "set aside as " + aside);
  }
  return changes;
}

void ChangeFile::append(const StateChange& change) {
  if (write_all(file_, line_of(change))) {
    ++lines_;
    synced_ = false;
    return;
  }
  trouble(fmt::format("{} cannot be written: {}", path_, std::strerror(errno)));
  file_.reset();  // the file may end with part of the line
}

void ChangeFile::sync() {
  if (!file_ || std::exchange(synced_, true) || fdatasync(file_.get()) == 0) return;
  trouble(fmt::format("{} cannot be brought to the disk: {}", path_, std::strerror(errno)));
  file_.reset();  // the system may have dropped what it could not write, so the next change writes all again
}

void ChangeFile::replace(const std::deque<StateChange>& all) {
  file_.reset();
  std::string text;
  for (const auto& change : all) text += line_of(change);
  try {
    config::replace_file(path_, text, S_IRUSR | S_IWUSR);
  } catch (const config::Error& e) {
    trouble(e.what());
    return;
  }
  file_ = processes::OwnedDescriptor(open(path_.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC));
  lines_ = all.size();
  synced_ = true;
  told_ = false;
}

void ChangeFile::trouble(const std::string& problem) {
  if (std::exchange(told_, true)) return;
  logger.warn("{}; until that works, what happens to drivers is forgotten when this gateway restarts", problem);
}

}  // namespace iotcloud::gateway
