# Precompiled headers: parsing headers is a third of the time to compile. In the preset `release` the rooms do without,
# so one of their sources that forgets an include does not build there.
#   iotcloud_precompiled(TARGET rooms|tests)
# Code of a library and of a program is compiled with different flags (-fPIC, -fPIE), so there is one header for each.
set(_iotcloud_precompiled_rooms
  <algorithm> <array> <atomic> <chrono> <cstdint> <deque> <functional> <map> <memory> <mutex> <optional> <set> <span>
  <string> <string_view> <thread> <unordered_map> <utility> <variant> <vector> <condition_variable> <fmt/format.h>)
set(_iotcloud_precompiled_tests ${_iotcloud_precompiled_rooms} <filesystem> <fstream> <future> <gmock/gmock.h> <gtest/gtest.h>)

function(iotcloud_precompiled target kind)
  if(NOT kind IN_LIST IOTCLOUD_PRECOMPILE)
    return()
  endif()
  set(header iotcloud_precompiled_${kind})
  if(NOT TARGET ${header})
    file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/${header}.cc CONTENT "")
    if(kind STREQUAL tests)
      add_executable(${header} EXCLUDE_FROM_ALL ${PROJECT_BINARY_DIR}/${header}.cc)
      target_link_libraries(${header} PRIVATE iotcloud_test_options GTest::gmock_main)
    else()
      add_library(${header} STATIC EXCLUDE_FROM_ALL ${PROJECT_BINARY_DIR}/${header}.cc)
    endif()
    target_link_libraries(${header} PRIVATE fmt::fmt $<BUILD_INTERFACE:iotcloud_warnings>)
    target_precompile_headers(${header} PRIVATE ${_iotcloud_precompiled_${kind}})
  endif()
  target_precompile_headers(${target} REUSE_FROM ${header})
  # Where a definition of the target's own touches what is in it the compiler reads the text instead.
  set_target_properties(${target} PROPERTIES PCH_WARN_INVALID OFF)
endfunction()
