#include <optional>
#include <system_error>

#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>
#include <iotcloud/processes/frames.h>
#include <iotcloud/processes/starter_protocol.h>

namespace iotcloud::processes {

namespace {

/// A frame of words, each of which is ended by a zero byte.
std::string frame_of(const std::vector<std::string>& words) {
  std::string body;
  for (const auto& word : words) (body += word) += '\0';
  return frame(body);
}

/// The words of a frame's body; none if the last one has no '\0' at its end.
std::vector<std::string> words_of(const std::string& body) {
  std::vector<std::string> words;
  if (body.empty() || body.back() != '\0') return words;
  for (std::size_t begin = 0, end = 0; (end = body.find('\0', begin)) != std::string::npos; begin = end + 1) {
    words.push_back(body.substr(begin, end - begin));
  }
  return words;
}

}  // namespace

std::string encode(const StarterRequest& request) {
  if (request.kind == StarterRequest::Kind::kill) return frame_of({"kill"});
  std::vector<std::string> words = {"run", std::to_string(request.arguments.size())};
  words.insert(words.end(), request.arguments.begin(), request.arguments.end());
  words.insert(words.end(), request.environment.begin(), request.environment.end());
  return frame_of(words);
}

std::string encode(const StarterAnswer& answer) {
  switch (answer.kind) {
    case StarterAnswer::Kind::started:
      return frame_of({"started", std::to_string(answer.number)});
    case StarterAnswer::Kind::ended:
      return frame_of({"ended", std::to_string(answer.number)});
    case StarterAnswer::Kind::killed:
      return frame_of({"killed"});
    case StarterAnswer::Kind::failed:
      break;
  }
  return frame_of({"failed", answer.reason});
}

StarterRequest decode_request(const std::string& body) {
  const auto words = words_of(body);
  if (words.size() == 1 && words.front() == "kill") return {StarterRequest::Kind::kill, {}, {}};
  const auto count = words.size() > 2 && words.front() == "run" ? config::parse_number<int>(words[1]) : std::nullopt;
  if (!count || *count < 1 || static_cast<std::size_t>(*count) > words.size() - 2) {
    throw config::Error("this request is none that this version knows");
  }
  const auto first = words.begin() + 2;
  return {StarterRequest::Kind::run, {first, first + *count}, {first + *count, words.end()}};
}

StarterAnswer decode_answer(const std::string& body) {
  const auto words = words_of(body);
  if (words.size() == 1 && words.front() == "killed") return {StarterAnswer::Kind::killed, 0, {}};
  if (words.size() == 2 && words.front() == "failed") return {StarterAnswer::Kind::failed, 0, words.back()};
  const auto number = words.size() == 2 ? config::parse_number<int>(words.back()) : std::nullopt;
  if (number && *number > 1 && words.front() == "started") return {StarterAnswer::Kind::started, *number, {}};
  if (number && words.front() == "ended") return {StarterAnswer::Kind::ended, *number, {}};
  throw config::Error("what starts processes of another user gives an answer that this version does not know");
}

}  // namespace iotcloud::processes
