#pragma once

#include <cstddef>
#include <string>
#include <utility>

#include <iotcloud/config/error.h>

/// The words by which the values of an enumeration travel, and people name them: a list of values and words, read in
/// both directions.
namespace iotcloud::discovery {

template <typename Value>
using Word = std::pair<Value, const char*>;

/// \return the value's word; "unknown": the list has none
template <typename Value, std::size_t count>
std::string word_of(const Value& wanted, const Word<Value> (&words)[count]) {
  for (const auto& [value, word] : words) {
    if (value == wanted) return word;
  }
  return "unknown";
}

/// \param what "driver state", in the error's text. \throws config::Error that names all words
template <typename Value, std::size_t count>
Value value_named(const std::string& given, const Word<Value> (&words)[count], const char* what) {
  std::string known;
  for (const auto& [value, word] : words) {
    if (given == word) return value;
    known += (known.empty() ? "" : ", ") + std::string(word);
  }
  throw config::Error("\"" + given + "\" is no " + what + "; there are: " + known);
}

}  // namespace iotcloud::discovery
