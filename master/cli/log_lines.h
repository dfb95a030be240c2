#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <string>

#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

/// Most bytes of a log that are read at a time.
inline constexpr std::int32_t most_log_bytes = 128 * 1024;

/// The last `most` lines of the text that contain `word`.
std::deque<std::string> last_lines(const std::string& text, const std::string& word, std::size_t most);

/// What a verb shows of a log.
struct LogChoice {
  std::string word;          ///< only lines with it; empty: all
  std::int32_t lines = 100;  ///< how many of those that are there, at most
  bool follow = false;       ///< go on until interrupted
};

/// Prints the end of a log and, if that is chosen, what is added to it: in JSON each line is a string, in YAML an item
/// of a list. \param read reads on from a position; the first one is empty. \return the exit status
int show_log(Call& call, const LogChoice& choice, const std::function<LogPart(const std::string& position)>& read);

}  // namespace iotcloud::master::cli
