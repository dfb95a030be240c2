#include <cerrno>
#include <charconv>
#include <cstring>
#include <fstream>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/audit_chain.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::security {

namespace {

constexpr std::size_t hash_digits = 64;

/// Takes a number from the beginning of the text.
std::optional<std::uint64_t> take_number(std::string_view& text) {
  std::uint64_t number = 0;
  const auto [end, problem] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (problem != std::errc{}) return std::nullopt;
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  return number;
}

bool take(std::string_view& text, std::string_view beginning) {
  if (!text.starts_with(beginning)) return false;
  text.remove_prefix(beginning.size());
  return true;
}

/// Reads the files line by line.
class AuditReading {
 public:
  explicit AuditReading(const AuditExpectation& expected) : expected_(expected) {}

  void read(const std::string& file) {
    std::ifstream in(file, std::ios::binary);
    if (!in) throw config::Error(fmt::format("{} cannot be read: {}", file, std::strerror(errno)));
    file_ = file;
    line_ = 0;
    before_ = Sha256();
    for (std::string text; std::getline(in, text);) {
      ++line_;
      if (in.eof()) {
        find("this line was not written to its end");
        continue;
      }
      check(text);
    }
    if (in.bad()) throw config::Error(fmt::format("{} cannot be read to its end: {}", file, std::strerror(errno)));
  }

  AuditVerdict end() {
    line_ = 0;
    if (expected_.has_head) check_tail();
    if (expected_.known && !known_seen_) {
      const bool is_later = expected_.known->number > verdict_.head.number;
      find(is_later ? fmt::format("line {}, which was there once, is missing: it ends with line {}",
                                  expected_.known->number, verdict_.head.number)
                    : fmt::format("line {}, which was there once, is missing", expected_.known->number));
    }
    return std::move(verdict_);
  }

 private:
  void find(std::string text) { verdict_.findings.push_back({file_, line_, std::move(text)}); }

  void check(const std::string& text) {
    const auto link = parse_audit_link(text);
    if (!link) {
      if (verdict_.first == 0) {
        ++verdict_.unchained;
        before_.add(text);
        before_.add("\n");
      } else {
        find("this is no line of an audit log");
      }
      return;
    }
    const std::string hash = sha256_hex(text);
    if (verdict_.first == 0) {
      begin(*link);
    } else {
      follow(*link);
    }
    verdict_.head = {link->number, hash};
    if (!expected_.known || expected_.known->number != link->number) return;
    known_seen_ = true;
    if (expected_.known->hash != hash)
      find(fmt::format("line {} was changed, or one before it: its hash was another one", link->number));
  }

  void begin(const AuditLink& link) {
    verdict_.first = link.number;
    if (link.number == 1 && link.previous != before_.hex()) find("the lines before line 1 were changed or removed");
    if (link.number != 1 && verdict_.unchained > 0) find("the lines before this one are no lines of an audit log");
    if (link.number > expected_.from) {
      find(fmt::format("it begins with line {}: lines {} to {} are in an older file, or were removed", link.number,
                       expected_.from, link.number - 1));
    }
  }

  void follow(const AuditLink& link) {
    const auto& last = verdict_.head;
    if (link.number > last.number + 1) {
      find(fmt::format("lines {} to {} are missing before this one", last.number + 1, link.number - 1));
    } else if (link.number <= last.number) {
      find(fmt::format("line {} comes after line {}: lines were put in another order, or added", link.number,
                       last.number));
    } else if (link.previous != last.hash) {
      find(fmt::format("line {} was changed after it was written, or another one was put in its place", last.number));
    }
  }

  void check_tail() {
    const auto head = read_audit_head(file_);
    if (!head) {
      find(
          fmt::format("{} is missing or damaged, so nothing says whether the end was cut off", audit_head_file(file_)));
    } else if (head->number > verdict_.head.number) {
      find(
          fmt::format("lines {} to {} are missing at its end: it was cut off", verdict_.head.number + 1, head->number));
    } else if (head->number == verdict_.head.number && head->hash != verdict_.head.hash) {
      find(fmt::format("line {}, the last one, was changed after it was written", head->number));
    }
  }

  const AuditExpectation expected_;
  AuditVerdict verdict_;
  std::string file_;
  std::size_t line_ = 0;
  Sha256 before_;  ///< of the lines before line 1
  bool known_seen_ = false;
};

}  // namespace

std::string to_string(const AuditHead& head) {
  return fmt::format("{}:{}", head.number, head.hash);
}

std::optional<AuditHead> parse_audit_head(std::string_view text) {
  while (text.ends_with('\n') || text.ends_with(' ')) text.remove_suffix(1);
  const auto number = take_number(text);
  if (!number || !take(text, ":") || !is_sha256(text)) return std::nullopt;
  return AuditHead{*number, std::string(text)};
}

std::string audit_head_file(const std::string& file) {
  return file + ".head";
}

std::optional<AuditHead> read_audit_head(const std::string& file) {
  std::ifstream in(audit_head_file(file));
  std::string line;
  std::getline(in, line);
  return parse_audit_head(line);
}

std::optional<AuditLink> parse_audit_link(std::string_view line) {
  if (!take(line, "{\"number\":")) return std::nullopt;
  const auto number = take_number(line);
  if (!number || *number == 0 || !take(line, ",\"previous\":\"")) return std::nullopt;
  const std::string_view previous = line.substr(0, hash_digits);
  if (!is_sha256(previous) || !line.substr(hash_digits).starts_with("\",") || !line.ends_with('}')) return std::nullopt;
  return AuditLink{*number, std::string(previous)};
}

AuditVerdict verify_audit(const std::vector<std::string>& files, const AuditExpectation& expected) {
  AuditReading reading(expected);
  for (const auto& file : files) reading.read(file);
  return reading.end();
}

}  // namespace iotcloud::security
