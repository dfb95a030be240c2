#include <algorithm>

#include <iotcloud/topology/runtime/trouble_board.h>

namespace iotcloud::topology {

void TroubleBoard::set(const std::string& component, const std::string& part, const std::string& text) {
  const config::MutexLock lock(mutex_);
  if (text.empty()) {
    texts_.erase({component, part});
  } else {
    texts_[{component, part}] = text;
  }
}

std::vector<TroubleBoard::Trouble> TroubleBoard::list() const {
  const config::MutexLock lock(mutex_);
  std::vector<Trouble> all;
  for (const auto& [place, text] : texts_) {
    Trouble trouble{place.first, text};
    if (std::find(all.begin(), all.end(), trouble) == all.end()) all.push_back(std::move(trouble));
  }
  return all;
}

std::string TroubleBoard::line() const {
  std::string line;
  for (const auto& [component, text] : list()) {
    if (!line.empty()) line += "; ";
    line.append(component).append(": ").append(text);
  }
  return line;
}

}  // namespace iotcloud::topology
