# Compiler settings that hold for every target, and the one include path.
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_CXX_VISIBILITY_PRESET hidden)
set(CMAKE_VISIBILITY_INLINES_HIDDEN ON)
# The target all_verify_interface_header_sets: every public header compiles alone.
set(CMAKE_VERIFY_INTERFACE_HEADER_SETS ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/bin)
set(CMAKE_LIBRARY_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/plugins)

set(IOTCLOUD_SANITIZE "" CACHE STRING "Sanitizers to build with, as for -fsanitize=")
set(IOTCLOUD_SANITIZE_OPTIMIZE 1 CACHE STRING "How far to optimize what is sanitized: at 0 it compiles in two thirds of the time")
if(IOTCLOUD_SANITIZE)
  add_compile_options(-fsanitize=${IOTCLOUD_SANITIZE} -fno-omit-frame-pointer -g1 -O${IOTCLOUD_SANITIZE_OPTIMIZE})
  add_link_options(-fsanitize=${IOTCLOUD_SANITIZE})
  if(IOTCLOUD_SANITIZE MATCHES undefined)
    add_compile_options(-fno-sanitize-recover=undefined)
    if(NOT IOTCLOUD_SANITIZE MATCHES fuzzer)
      # A third of the time to compile. A null pointer that is used ends the program with asan all the same; alignment is
      # checked where bytes are decoded, by the preset fuzz.
      add_compile_options(-fno-sanitize=null,alignment)
    endif()
  endif()
  # What sanitizers add makes programs of 100 MB and more, which it links in a third of the time.
  find_program(LLD_PROGRAM ld.lld)
  if(LLD_PROGRAM)
    add_link_options(-fuse-ld=lld)
  endif()
endif()

set(IOTCLOUD_PRECOMPILE "" CACHE STRING "For which of rooms;tests common headers are parsed once: IotcloudPrecompiled.cmake")

find_program(CCACHE_PROGRAM ccache)
if(CCACHE_PROGRAM)
  # No base_dir is set: __FILE__ and debug paths stay those of the checkout that was built.
  set(CMAKE_CXX_COMPILER_LAUNCHER ${CCACHE_PROGRAM})
  if(IOTCLOUD_PRECOMPILE)
    # Without these ccache passes on whatever uses a precompiled header.
    set(CMAKE_CXX_COMPILER_LAUNCHER ${CMAKE_COMMAND} -E env CCACHE_SLOPPINESS=pch_defines,time_macros ${CCACHE_PROGRAM})
    add_compile_options($<$<CXX_COMPILER_ID:GNU>:-fpch-preprocess>)
  endif()
endif()

add_library(iotcloud_warnings INTERFACE)
target_compile_options(iotcloud_warnings INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Woverloaded-virtual -Wold-style-cast -Wcast-qual
  -Wconversion -Wno-sign-conversion -Wimplicit-fallthrough -Werror
  # GCC 12 warns wrongly of std::string operator+ (its bug 105651).
  $<$<CXX_COMPILER_ID:GNU>:-Wno-restrict>)
if(rooms IN_LIST IOTCLOUD_PRECOMPILE AND CMAKE_CXX_COMPILER_ID STREQUAL GNU)
  # Sanitizers' code and precompiled headers hide from it what it must know here: the preset release warns of these.
  target_compile_options(iotcloud_warnings INTERFACE -Wno-array-bounds -Wno-stringop-overflow -Wno-stringop-overread
                                                     -Wno-maybe-uninitialized)
endif()

# For programs that test. Not for what is tested, which is compiled as it is shipped.
add_library(iotcloud_test_options INTERFACE)
target_compile_options(iotcloud_test_options INTERFACE $<$<CONFIG:Release>:-O1>)

# The include path equals the path on disk, in the tree and installed: <iotcloud/brokers/message.h>.
file(MAKE_DIRECTORY ${PROJECT_BINARY_DIR}/include)
file(CREATE_LINK ${PROJECT_SOURCE_DIR} ${PROJECT_BINARY_DIR}/include/iotcloud SYMBOLIC)
# What the Thrift compiler writes: "iotcloud/discovery/records_types.h" below this folder.
set(IOTCLOUD_GENERATED_DIR ${PROJECT_BINARY_DIR}/generated)
file(MAKE_DIRECTORY ${IOTCLOUD_GENERATED_DIR})
