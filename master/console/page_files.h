#pragma once

#include <string>
#include <string_view>

namespace iotcloud::master {

/// A file of the console's page, which is part of this program (README.md).
struct PageFile {
  std::string_view bytes;
  const char* content_type;
  std::string tag;  ///< for the header ETag
};

/// \return null: there is no such file
const PageFile* find_page_file(const std::string& path);

}  // namespace iotcloud::master
