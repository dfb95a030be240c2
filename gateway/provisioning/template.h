#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace iotcloud::gateway {

/// What a rule writes into a property, with places for attributes of what was found: `mqtt://{address:host}:1883`.
/// `{NAME}` or `{NAME:FORM}` is a place, `{{` and `}}` are braces. An attribute is input of a stranger: one that does
/// not have the form of its place fills none, so that it cannot mean anything that the rule's author did not write.
/// Immutable.
class Template {
 public:
  /// \throws config::Error that says what is wrong, and which forms there are
  static Template parse(std::string_view text);

  /// What a template gave for one thing that was found.
  struct Filled {
    std::optional<std::string> text;  ///< nullopt: not filled
    std::string missing;              ///< the attribute that was not found; empty: none is missing
    std::string problem;              ///< why an attribute does not fit, for people
  };
  Filled fill(const std::map<std::string, std::string>& attributes) const;
  bool has_places() const { return !places_.empty(); }
  friend bool operator==(const Template&, const Template&) = default;

 private:
  struct Place {
    std::string attribute, form;
    std::string after;  ///< the text behind it
    friend bool operator==(const Place&, const Place&) = default;
  };
  std::string before_;
  std::vector<Place> places_;
};

/// The value in this form; nullopt: it cannot have it. The forms:
/// - `word`: 1 to 200 letters, digits, `.`, `_`, `-`, not beginning with `.` or `-`; also the form of a place that
/// names none
/// - `name`: as `word`, at most 120; what cannot be in one becomes `-`, and then part of the value's SHA-256 is added,
/// so that
///   different values stay different
/// - `host`: an IPv4 address, an IPv6 address (in brackets, as URLs have it), or a machine's name
/// - `number`: digits, with a sign and a point
/// - `path`: an absolute path below /dev, without `..`
/// - `topic`: an MQTT topic without wildcards, commas, equals signs and spaces at its ends, not beginning with `$`
/// - `topics`: a list `TOPIC=CHANNEL, ...` of these, the channels as `word`
/// - `text`: UTF-8 without control characters, at most 256 bytes
std::optional<std::string> in_form(std::string_view form, const std::string& value);

/// The most bytes of a filled template.
inline constexpr std::size_t longest_filled = 8192;

}  // namespace iotcloud::gateway
