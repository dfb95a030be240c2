#include <iotcloud/config/error.h>

namespace iotcloud::config {

namespace {

std::string compose(const Location& where, const std::string& key, const std::string& problem,
                    const std::string& remedy) {
  std::string text = where.file;
  if (where.line > 0) text += ":" + std::to_string(where.line);
  if (where.column > 0) text += ":" + std::to_string(where.column);
  if (!text.empty()) text += ": ";
  if (!key.empty()) text += key + ": ";
  text += problem;
  if (!remedy.empty()) text += "; " + remedy;
  return text;
}

}  // namespace

ConfigError::ConfigError(const Location& where, const std::string& key, const std::string& problem,
                         const std::string& remedy)
    : Error(compose(where, key, problem, remedy)), where_(where), key_(key) {}

}  // namespace iotcloud::config
