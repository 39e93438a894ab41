/* python.exe: starts the interpreter of python311.dll. */
#include <windows.h>

typedef int (*Main)(int, wchar_t **);

int wmain(int argc, wchar_t **argv) {
    Main main = (Main)GetProcAddress(LoadLibraryW(L"python311.dll"), "Py_Main");
    return main ? main(argc, argv) : 98;
}
