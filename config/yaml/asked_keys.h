#pragma once

#include <string>
#include <vector>

namespace iotcloud::config {

/// A key that a reader asked a file for, whether the file has it or not: the source of a reference of all keys.
struct AskedKey {
  std::string path;      ///< dotted; `<name>` stands for names that the user chooses, `[]` for items of a sequence
  std::string kind;      ///< "text", "whole number", "duration", "mapping", ...
  std::string fallback;  ///< the value without the key; empty: no value. `required`: the key must exist
  std::string allowed;   ///< a range, or the choices; empty: anything of the kind
  bool required = false;
};

/// From now on all sections of this process note here the keys that readers ask for, each path once, in order.
/// \param into must outlive all reading; null ends it. Not thread safe: for a program that reads its configuration and
/// ends.
void record_asked_keys(std::vector<AskedKey>* into);

/// Writes a list of objects with `key`, `kind`, `required`, `default` and `allowed`.
std::string as_json(const std::vector<AskedKey>& keys);

namespace internal {
/// Does nothing if nobody records.
void note_asked(AskedKey key);
}  // namespace internal

}  // namespace iotcloud::config
