#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/gateway/change_file.h>

namespace iotcloud::gateway {
namespace {

using nlohmann::json;

constexpr config::Logger log{"gateway"};
constexpr std::size_t most_reason_bytes = 2000;  ///< a driver says what it likes

std::string line_of(const StateChange& change) {
  const json line = {{"time_ms", change.time_ms},
                     {"instance", change.instance},
                     {"driver", change.driver},
                     {"state", to_string(change.state)},
                     {"reason", change.reason.substr(0, most_reason_bytes)}};
  // What is no UTF-8, a character cut in two among it, is replaced.
  return line.dump(-1, ' ', false, json::error_handler_t::replace) + '\n';
}

/// \throws json::exception, config::Error.
StateChange change_of(const std::string& text) {
  const json line = json::parse(text);
  return {line.at("instance").get<std::string>(), line.at("driver").get<std::string>(),
          discovery::parse_driver_state(line.at("state").get<std::string>()), line.at("reason").get<std::string>(),
          line.at("time_ms").get<std::int64_t>()};
}

bool write_all(const OwnedDescriptor& file, const std::string& bytes) {
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
    while (std::getline(file, line) && !file.eof()) {  // at its end: without its line feed, so it is not whole
      ++number;
      changes.push_back(change_of(line));
      if (changes.size() > most_) changes.pop_front();
    }
  } catch (const std::exception& e) {
    const std::string aside = path_ + ".damaged";
    std::error_code error;
    std::filesystem::rename(path_, aside, error);
    log.warn("{}, the history of earlier lives, is damaged in line {} ({}); it is {}, and what stood before is kept",
             path_, number, e.what(), error ? "overwritten" : "set aside as " + aside);
  }
  return changes;
}

void ChangeFile::add(const std::deque<StateChange>& all) {
  if (!file_ || lines_ >= 2 * most_) {
    replace(all);
  } else {
    append(all.back());
  }
}

void ChangeFile::append(const StateChange& change) {
  if (write_all(file_, line_of(change))) {
    ++lines_;
    return;
  }
  trouble(std::strerror(errno));
  file_.reset();  // part of the line may be in it
}

/// The file under another name first, so that at no time there is half of it.
void ChangeFile::replace(const std::deque<StateChange>& all) {
  const std::string fresh = path_ + ".new";
  std::string text;
  for (const auto& change : all) text += line_of(change);
  OwnedDescriptor file(open(fresh.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_APPEND | O_CLOEXEC, S_IRUSR | S_IWUSR));
  if (!file || !write_all(file, text) || fdatasync(file.get()) != 0 || rename(fresh.c_str(), path_.c_str()) != 0) {
    trouble(std::strerror(errno));
    file_.reset();
    return;
  }
  file_ = std::move(file);
  lines_ = all.size();
  told_ = false;
}

void ChangeFile::trouble(const std::string& problem) {
  if (std::exchange(told_, true)) return;
  log.warn("{} cannot be written: {}; what happens to drivers is forgotten when this gateway restarts, until it can",
           path_, problem);
}

}  // namespace iotcloud::gateway
