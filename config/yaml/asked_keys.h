#pragma once

#include <string>
#include <vector>

namespace iotcloud::config {

/// A key that a reader asked a file for, there or not: what a reference of all keys is made of.
struct AskedKey {
  std::string path;      ///< dotted; `<name>` stands for names that the user chooses, `[]` for items of a sequence
  std::string kind;      ///< "text", "whole number", "duration", "mapping", ...
  std::string fallback;  ///< what counts without the key; empty: nothing. `required`: it has to be there
  std::string allowed;   ///< a range, or the choices; empty: anything of the kind
  bool required = false;
};

/// From now on all sections of this process note here what they are asked for, each path once, in order.
/// \param into outlives all reading; null ends it. Not thread safe: for a program that reads its configuration and
/// ends.
void record_asked_keys(std::vector<AskedKey>* into);

/// A list of objects with `key`, `kind`, `required`, `default` and `allowed`.
std::string as_json(const std::vector<AskedKey>& keys);

namespace internal {
/// Does nothing when nobody records.
void note_asked(AskedKey key);
}  // namespace internal

}  // namespace iotcloud::config
