#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// The chain that makes an audit log show tampering. Each line begins with its number and the SHA-256 of the line
/// before it (without the end of line): {"number":2,"previous":"9f86...","time":...}. Line 1 has the SHA-256 of all
/// bytes before it in its file instead: nothing, or lines that a version without chain wrote. The chain goes on over
/// files that are rotated away and over restarts. A last line has no successor that vouches for it: the file FILE.head
/// beside the log has the number and the SHA-256 of the last line.
namespace iotcloud::security {

/// A place in the chain: a line's number and SHA-256.
struct AuditHead {
  std::uint64_t number = 0;
  std::string hash;  ///< 64 hexadecimal digits

  friend bool operator==(const AuditHead&, const AuditHead&) = default;
};
/// "120:9f86..."
std::string to_string(const AuditHead& head);
/// Reads to_string()'s text. \return nullopt if it is none
std::optional<AuditHead> parse_audit_head(std::string_view text);

/// The name of the file that has the head of this audit log.
std::string audit_head_file(const std::string& file);
/// Reads that file. \return nullopt if it is missing or holds no head
std::optional<AuditHead> read_audit_head(const std::string& file);

/// The number and previous hash with which a line begins.
struct AuditLink {
  std::uint64_t number = 0;
  std::string previous;
};
/// \return nullopt if the line has no place in a chain
std::optional<AuditLink> parse_audit_link(std::string_view line);

/// A fault at one place of an audit log.
struct AuditFinding {
  std::string file;
  std::size_t line = 0;  ///< of the file, from 1; 0: the file as a whole
  std::string text;
};

/// The result of verify_audit().
struct AuditVerdict {
  std::uint64_t first = 0;      ///< number of the first line of the chain; 0: there is none
  AuditHead head;               ///< the last line
  std::uint64_t unchained = 0;  ///< lines before line 1, of a version without chain
  std::vector<AuditFinding> findings;
};

/// With what verify_audit() compares the files.
struct AuditExpectation {
  /// A head that somebody kept elsewhere: the line of that number must be there, and unchanged.
  std::optional<AuditHead> known;
  /// The last file is the one that a daemon writes: it ends where its FILE.head says, or later.
  bool has_head = true;
  /// The first line may have this number: older files were deleted on purpose.
  std::uint64_t from = 1;
};

/// Checks files of one audit log, the oldest first: finds lines that were changed, removed, put in another order or
/// added, and a tail that was cut off. It cannot find what was changed by someone who computed all later hashes and
/// FILE.head anew, unless `known` is a head of before. \throws Error if a file cannot be read.
AuditVerdict verify_audit(const std::vector<std::string>& files, const AuditExpectation& expected);

}  // namespace iotcloud::security
