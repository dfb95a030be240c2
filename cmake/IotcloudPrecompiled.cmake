# Precompiled headers: parsing headers is a third of the time to compile. The preset `lint` uses neither them nor unity
# builds, so ./dev lint finds a source that forgets an include.
#   iotcloud_precompiled(TARGET rooms|hot|tests)
# Libraries and programs are compiled with different flags (-fPIC, -fPIE), so each kind has a header of its own; so have HOT rooms,
# because GCC 12 breaks off at -O3 with a header precompiled at -O1.
set(_iotcloud_precompiled_rooms
  <algorithm> <array> <atomic> <chrono> <cstdint> <deque> <functional> <map> <memory> <mutex> <optional> <set> <span>
  <string> <string_view> <thread> <unordered_map> <utility> <variant> <vector> <condition_variable> <fmt/format.h>)
set(_iotcloud_precompiled_hot ${_iotcloud_precompiled_rooms})
set(_iotcloud_precompiled_tests ${_iotcloud_precompiled_rooms} <filesystem> <fstream> <future> <gmock/gmock.h> <gtest/gtest.h>)

function(iotcloud_precompiled target kind)
  string(REPLACE hot rooms chosen ${kind})
  if(NOT chosen IN_LIST IOTCLOUD_PRECOMPILE)
    return()
  endif()
  set(header iotcloud_precompiled_${kind})
  if(NOT TARGET ${header})
    file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/${header}.cc CONTENT "")
    if(kind STREQUAL tests)
      add_executable(${header} EXCLUDE_FROM_ALL ${PROJECT_BINARY_DIR}/${header}.cc)
      target_link_libraries(${header} PRIVATE GTest::gmock_main)
      _iotcloud_test_code(${header})
    else()
      add_library(${header} STATIC EXCLUDE_FROM_ALL ${PROJECT_BINARY_DIR}/${header}.cc)
    endif()
    if(kind STREQUAL hot)
      _iotcloud_hot(${header})
    endif()
    target_link_libraries(${header} PRIVATE fmt::fmt $<BUILD_INTERFACE:iotcloud_warnings>)
    target_precompile_headers(${header} PRIVATE ${_iotcloud_precompiled_${kind}})
  endif()
  target_precompile_headers(${target} REUSE_FROM ${header})
  # GCC looks for garbage whenever 128 MB are in use, and looks through the whole precompiled header each time: a seventh
  # of its time. Few sources use 512 MB.
  target_compile_options(${target} PRIVATE $<$<CXX_COMPILER_ID:GNU>:--param=ggc-min-heapsize=524288>)
  # If a definition of the target affects the header, the compiler reads its text instead, without a warning.
  set_target_properties(${target} PROPERTIES PCH_WARN_INVALID OFF)
endfunction()
