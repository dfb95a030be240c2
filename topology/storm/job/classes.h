#pragma once

#include <string>

namespace iotcloud::topology::storm {

/// What a component library registers, as Library.java reads it: {"spout": {CLASS: {STREAM: {"fields": [...],
/// "direct": false}}}, "bolt": the same, "grouping": {CLASS: {}}}. \throws config::Error when the file is no component
/// library, or one of its classes cannot be made and asked.
std::string classes_of(const std::string& library);

}  // namespace iotcloud::topology::storm
